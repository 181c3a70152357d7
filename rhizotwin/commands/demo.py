"""Command `rhizotwin demo`."""

from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import Computing, Flag, OutputFolder, Page, Profile


def demo(
    *,
    output: OutputFolder | None = None,
    small: Flag = False,
    show: Flag = False,
    profile: Profile = "clean",
    page: Page = Page(),
    computing: Computing = Computing(),
) -> None:
    """Simulate, reconstruct and score a small printed root (about two minutes), or show a finished example.

    The demonstration renders pictures of a small 3D-printed root, reconstructs the root from these pictures, compares
    the result with the true root, and writes a report. With --show, a finished example, a print with a manual
    correction, or the finished demonstration in the folder, is opened in the viewer, and its report is opened.

    Parameters
    ----------
    output : Path, optional
        Folder for all files; default: demo, or example with --show. A finished demonstration in the folder is replaced,
        and an interrupted one is continued.
    small : bool
        Use fewer and smaller pictures, larger voxels and no figures (under a minute).
    show : bool
        Show a finished example in the browser at once, without simulation.
    profile : str
        Simulated imperfections of rig and pictures: clean (none), bench (well-built rig), camera (bench with an
        ordinary camera), harsh (badly adjusted rig), real (first scan of a living plant), or a TOML file.
    page : Page
        Address of the viewer with --show.
    computing : Computing
        Device of the computation, and progress output.

    Examples
    --------
    rhizotwin demo
    rhizotwin demo --small
    rhizotwin demo --show
    rhizotwin demo -o my_demo --profile bench
    """
    if show:
        if small:
            raise UserError("--show opens a finished example, and --small simulates one; give one of them")
        _show(Path("example") if output is None else output, page)
        return
    from rhizotwin.steps import demo as steps

    command_steps.start_engine(computing.device, quiet=computing.quiet)
    folder = Path("demo") if output is None else output
    steps.demo(folder, profile=profile, size=steps.SMALL if small else steps.FULL, say=print, progress=computing)


def _show(folder: Path, page: Page) -> None:
    """Show the result in a folder, which is the example if the folder is new or empty."""
    from rhizotwin.commands.view import view
    from rhizotwin.steps.example import write_example
    from rhizotwin.viewer.private_page import open_page

    result = folder / "result"
    if not (result / "result.json").is_file():
        write_example(folder)
    print(f"report: {result / 'report.html'}", flush=True)
    if not page.no_browser:
        open_page((result / "report.html").resolve().as_uri())
    view([result], page=page)
