"""Print a calibration board, and find the camera's lens from pictures of it.

Three steps: print the board, take about 20 pictures of it, and fit the lens to them. 'simulate' renders such pictures
with a scene's camera, to try it out.

Examples
--------
rhizotwin calibrate board -o board.pdf
rhizotwin calibrate camera my_board_pictures --board board.toml -o my_lens
rhizotwin calibrate simulate printed_8ml -o my_board_pictures --profile bench
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from cyclopts import Parameter

from rhizotwin import command_steps
from rhizotwin.arguments import Device, ImageWh, OutputFile, OutputFolder, Profile, Progress, SceneName, Seed, named, option, output, whole
from rhizotwin.pages import BoardOptions, PageOptions
from rhizotwin.scene_changes import change_scene
from rhizotwin.scenes import files
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Scene

if TYPE_CHECKING:
    from rhizotwin.rig.lens.calibration import Calibration

PICTURES_LIMITS = (3, 1000)
OutputPictures: TypeAlias = Annotated[Path, output("PICTURES")]


def read_pictures(text: str) -> int:
    """Read a number of pictures."""
    low, high = PICTURES_LIMITS
    return whole(text, low, high, f"give {low} to {high}")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class BoardPictures:
    """How the pictures are taken."""

    profile: Profile | None = None
    """Distortion, blur and noise of the camera, or a file; default: the scene's own."""
    pictures: Annotated[int, option(read_pictures, "N")] = 20
    """How many."""
    image_wh: ImageWh | None = None
    """Picture size in pixels, such as 800x600; default: the scene's."""
    seed: Seed = 0
    """Random seed for poses and noise: 0, 1, 2, ..."""


def board(*, output: OutputFile, page: PageOptions = PageOptions(), drawn: BoardOptions = BoardOptions()) -> None:
    """Write the calibration board for the printer, at true scale.

    A ChArUco board is written as one PDF or SVG page, with a ruler to check the printer by, and beside it, under the
    same name, a board file (.toml) that tells 'calibrate camera' what was printed.

    Parameters
    ----------
    output : Path
        File to write, .pdf or .svg; must not exist yet.
    page : PageOptions
        What it is printed on.
    drawn : BoardOptions
        The board.

    Examples
    --------
    rhizotwin calibrate board -o board.pdf
    rhizotwin calibrate board -o board.svg --page a3 --squares 9x7 --square-mm 35
    """
    from rhizotwin.rig.printing.print_board import board_page
    from rhizotwin.rig.printing.print_files import write_pages
    from rhizotwin.scenes.board import save_board

    made = drawn.board()
    described = output.with_suffix(".toml")
    if described.exists():
        raise UserError(f"{described} exists already, and the board's description would be written there; choose another name or remove it")
    title = f"ChArUco board, {made.squares_xy[0]}x{made.squares_xy[1]} squares of {made.square_mm:g} mm"
    write_pages([board_page(made, paper=page.paper())], output, title=title)
    save_board(made, described)
    print(f"{title}: {output}, described by {described}")
    print("print at 100 %, glue it on something flat, take about 20 pictures of it")
    print(f"next: rhizotwin calibrate camera PICTURES --board {described} -o my_lens")


def camera(
    pictures: Annotated[Path, named("PICTURES")],
    /,
    *,
    output: OutputFolder,
    board: Annotated[Path | None, named("FILE")] = None,
    drawn: BoardOptions = BoardOptions(),
    scene: SceneName | None = None,
    progress: Progress = Progress(),
) -> None:
    """Fit the lens to pictures of the calibration board.

    Find focal length, principal point and distortion from pictures of the board, all taken at the focus of the scan.
    Pictures that cannot be used are named with the reason. Writes camera.toml (a [camera] section for scene files),
    calibration.json (every number) and report.html (residuals, coverage, each picture).

    Parameters
    ----------
    pictures : Path
        Folder of pictures (PNG, JPG, TIFF) of the board, of one size.
    output : Path
        Folder to write to: new or empty.
    board : Path, optional
        Board file that was written with the board; default: board.toml in PICTURES if it is there, else the sizes
        below.
    drawn : BoardOptions
        The board, where there is no file of it.
    scene : str, optional
        Also write scene.toml: this scene with the calibrated camera; its picture size must be the pictures'.
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin calibrate camera my_board_pictures --board board.toml -o my_lens
    rhizotwin calibrate camera my_board_pictures --squares 7x5 --square-mm 30 -o my_lens --scene my_scene.toml
    """
    from rhizotwin.picture_files import list_pictures
    from rhizotwin.rig.lens.calibration import calibrate as fit
    from rhizotwin.rig.lens.calibration import write_calibration
    from rhizotwin.rig.lens.calibration_report import write_report
    from rhizotwin.scenes.folders import new_folder

    paths = list_pictures(pictures)
    given = None if scene is None else files.load_scene(scene)
    shown = drawn.board_of(board or _board_beside(pictures, drawn))
    with progress.bar(boards=1.0) as bar:
        made = fit(paths, shown, monitor=bar)
    calibrated = None if given is None else _with_camera(given, made.camera)
    with new_folder(output) as building:
        written = [*write_calibration(made, building), write_report(made, building)]
        if calibrated is not None:
            files.save_scene(calibrated, building / "scene.toml")
            written.append(building / "scene.toml")
        names = [path.name for path in written]
    _tell(made, of=len(paths))
    for name in names:
        print(f"  {output / name}")


def _board_beside(pictures: Path, drawn: BoardOptions) -> Path | None:
    """Return the board's file among the pictures, where no board is given."""
    beside = pictures / "board.toml"
    if drawn.given() or not beside.is_file():
        return None
    print(f"the board is as {beside} says")
    return beside


def _tell(made: "Calibration", *, of: int) -> None:
    """Print the lens that so many pictures told."""
    for name, reason in made.rejected.items():
        print(f"left out {name}: {reason}")
    for warning in made.warnings:
        print(f"warning: {warning}")
    from rhizotwin.rig.lens.calibration import model_text

    lens, found = made.camera, made.fit
    std_x, std_y = found.principal_std_px
    print(f"focal length {lens.focal_px[0]:.2f}, {lens.focal_px[1]:.2f} px (standard deviation {found.focal_std_px[0]:.2f} px)")
    print(f"principal point {lens.principal_px[0]:.2f}, {lens.principal_px[1]:.2f} px (standard deviations {std_x:.2f}, {std_y:.2f} px)")
    print(f"fitted: {model_text(found)}")
    print(f"residual {found.rms_px:.3f} px rms of {found.corners} corners in {len(found.views)} of {of} pictures")


def transfer(
    pictures: Annotated[Path, named("PICTURES")], /, *, output: OutputFile, exposures_s: Annotated[str | None, named("S,S,...")] = None
) -> None:
    """Measure the camera's curve from light to numbers, from a series of exposures.

    Take five pictures or more of one still scene that holds every grey, such as the lit panel with the canister before
    it, from much too dark to much too bright; change the exposure time only. The file that is written goes into the
    scene's [camera].

    Parameters
    ----------
    pictures : Path
        Folder with the pictures, in the natural order of their names.
    output : Path
        File to write (.toml); must not exist yet.
    exposures_s : str, optional
        Exposure times in seconds, with commas, in the order of the pictures; default: as their EXIF says.

    Examples
    --------
    rhizotwin calibrate transfer my_exposures -o my_transfer.toml
    rhizotwin calibrate transfer my_exposures --exposures-s 0.002,0.004,0.008,0.016 -o my_transfer.toml
    """
    from rhizotwin.picture_files import list_pictures
    from rhizotwin.rig.lens.transfer_fit import fit_transfer
    from rhizotwin.rig.lens.transfer_series import read_series, transfer_text
    from rhizotwin.scenes.atomic import write_text

    if output.exists():
        raise UserError(f"{output} exists already; choose another name or remove it")
    images, times = read_series(list_pictures(pictures), exposures_s)
    found = fit_transfer(images, times)
    write_text(output, transfer_text(found, len(images)))
    low, high = found.reached
    print(f"the camera's curve is {found.curve.name}, from {100.0 * low:.0f} to {100.0 * high:.0f} % of full scale")
    print(f"residual {100.0 * found.residual:.1f} % of the light, rms, in {len(images)} pictures of {min(times):g} to {max(times):g} s")
    print(f"  {output}: put it into the scene's [camera]")


def simulate(
    scene: SceneName,
    /,
    *,
    output: OutputPictures,
    taken: BoardPictures = BoardPictures(),
    drawn: BoardOptions = BoardOptions(),
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Render pictures of the calibration board with a scene's camera.

    The board is rendered before the scene's camera at its working distance, with the lens distortion, blur and noise of
    a profile. The true lens is in truth/camera.json, board.toml beside the pictures.

    Parameters
    ----------
    scene : str
        A name from 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        Folder to write to: new or empty.
    taken : BoardPictures
        How the pictures are taken.
    drawn : BoardOptions
        The board.
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin calibrate simulate printed_8ml -o my_board_pictures --profile bench
    rhizotwin calibrate camera my_board_pictures -o my_lens
    """
    changed = change_scene(files.load_scene(scene), image_wh=taken.image_wh, profile=taken.profile)
    made = drawn.board()
    command_steps.start_engine(device, quiet=progress.quiet)
    from rhizotwin.sim.board import simulate_board

    with progress.bar(render=1.0) as bar:
        simulate_board(changed, made, output, pictures=taken.pictures, seed=taken.seed, monitor=bar)
    print(f"{taken.pictures} pictures of the board in {output}, the true lens in {output / 'truth' / 'camera.json'}")
    print(f"next: rhizotwin calibrate camera {output} -o my_lens")


def _with_camera(scene: Scene, found: Camera) -> Scene:
    """Return a scene with the calibrated camera; its converter's depth stays."""
    if scene.camera.image_wh != found.image_wh:
        (wide, high), (width, height) = scene.camera.image_wh, found.image_wh
        raise UserError(
            f"scene {scene.name}: its camera takes pictures of {wide}x{high} px, but those of the board are {width}x{height}; "
            "set camera.image_wh, or take the pictures of the board as the scan takes its own"
        )
    calibrated = replace(scene, camera=replace(found, bits=scene.camera.bits))
    check_scene(calibrated, where=f"scene {scene.name} with the calibrated camera")
    return calibrated
