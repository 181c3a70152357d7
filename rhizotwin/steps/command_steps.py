"""Steps shared by several commands, such as starting the compute engine and reconstructing a dataset."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rhizotwin import engine
from rhizotwin.scenes.figures import FigureFormat
from rhizotwin.steps.arguments import Page, Progress
from rhizotwin.steps.calls import SHARES
from rhizotwin.steps.front_door import Method, reconstruct
from rhizotwin.viewer import private_page

if TYPE_CHECKING:
    from rhizotwin.recon.settings import PictureSettings, Settings
    from rhizotwin.scenes.model import Scene


def start_engine(device: str, *, quiet: bool = False) -> None:
    """Start the compute engine on a device, and print the name of the device."""
    chosen = engine.start(device)
    if not quiet:
        print(chosen)


def open_page(address: str, port: int, page: Page) -> None:
    """Print the address of a page, and open it in a browser unless ``--no-browser`` is given."""
    print(address, flush=True)
    print(f"to open it on another computer, run ssh -L {port}:localhost:{port} THIS_COMPUTER there, then use the same address", flush=True)
    if not page.no_browser:
        private_page.open_page(address)


def settings_of(file: Path | None, *, voxel_mm: float | None = None, pictures: "PictureSettings | None" = None) -> "Settings":
    """Load the settings of a reconstruction from a TOML file, or use the defaults.

    Parameters
    ----------
    file : Path, optional
        TOML file with the fields of `recon.settings.Settings`.
    voxel_mm : float, optional
        Edge length of the smallest voxels, mm; overrides the file.
    pictures : PictureSettings, optional
        Selection of pictures, combined with the selection in the file.

    Raises
    ------
    UserError
        If the file cannot be read or is invalid.
    """
    from rhizotwin.recon.settings import Settings, load_settings

    chosen = Settings() if file is None else load_settings(file)
    chosen = chosen if voxel_mm is None else replace(chosen, voxel_mm=voxel_mm)
    return chosen if pictures is None else replace(chosen, pictures=chosen.pictures.joined(pictures))


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Options of a reconstruction, see `front_door.reconstruct`."""

    settings: "Settings | None" = None
    """Settings of the reconstruction, see `settings_of`."""
    mass_g: float | None = None
    """Weighed mass of the specimen, g."""
    keep_stages: bool = False
    """Save the intermediate results in the subfolder ``stages`` of the result."""
    method: Method = "ours"
    """Reconstruction method."""


def reconstruct_whole(
    dataset: Path, output: Path, wanted: Wanted, *, figures: FigureFormat | None = None, progress: Progress = Progress()
) -> list[Path]:
    """Reconstruct a dataset, and write the result folder with the picture of its shape and its report.

    The folder appears only when it is complete.

    Parameters
    ----------
    wanted : Wanted
        Options of the reconstruction.
    figures : {"png", "svg", "pdf"}, optional
        Also write figures for documents in this format, see `write_pictures`.
    progress : Progress
        Progress output.

    Returns
    -------
    list of Path
        Paths of the pictures and of the report.

    Raises
    ------
    UserError
        If the dataset cannot be used, or ``output`` contains files that are not part of a result.
    """
    from rhizotwin.report import page
    from rhizotwin.report.report_data import ReportData
    from rhizotwin.report.result_pictures import write_pictures
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.stored import save

    save.check_place(output, dataset)  # before the long computation
    # loaded only once, so that later changes of the folder have no effect
    loaded = load_dataset(dataset)
    with save.new_result(output, source=dataset) as building:
        with progress.bar(**SHARES) as monitor:
            options: dict[str, Any] = vars(wanted) | {"keep_stages": building / "stages" if wanted.keep_stages else None}
            result = reconstruct(loaded, **options, monitor=monitor)
            result.write(building)
            with monitor.stage("pictures"):
                report = ReportData.of(result, building, loaded)
                written = write_pictures(report, figures=figures)
                written.append(page.write(report))
        names = [path.relative_to(building) for path in written]
    return [output / name for name in names]


def print_marker_warnings(scene: "Scene") -> None:
    """Print a warning for each ring in which the camera poses cannot be estimated reliably.

    This is the case if too few markers are visible in its pictures.
    """
    from rhizotwin.scenes import plan

    for warning in plan.marker_warnings(scene):
        print(f"warning: {warning}")
