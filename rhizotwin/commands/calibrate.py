"""Calibrate the camera: print a calibration board and fit the lens to pictures of it.

Print the board (a pattern of squares and markers), take about 20 pictures of it, and fit the lens to the pictures. To
try this without a camera, render pictures of the board with 'calibrate simulate'.

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

from rhizotwin.commands.page_options import BoardOptions, PageOptions
from rhizotwin.scenes import files
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import (
    Computing,
    ImageWh,
    OutputFile,
    OutputFolder,
    Profile,
    Progress,
    SceneChanges,
    SceneName,
    Seed,
    option,
    output,
    read_integer,
    with_metavar,
)
from rhizotwin.steps.scene_changes import change_scene

if TYPE_CHECKING:
    from rhizotwin.rig.lens.calibration import Calibration
    from rhizotwin.scenes.board import CharucoBoard

PICTURES_LIMITS = (3, 1000)
OutputPictures: TypeAlias = Annotated[Path, output("PICTURES")]


def read_pictures(text: str) -> int:
    """Convert text to a number of pictures."""
    low, high = PICTURES_LIMITS
    return read_integer(text, low, high, f"give {low} to {high}")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class BoardPictures:
    """Options of the simulated pictures of the calibration board."""

    profile: Profile | None = None
    """Profile of simulated imperfections (distortion, blur and noise of the camera): clean, bench, camera, harsh, \
real, or a TOML file; default: as in the scene."""
    pictures: Annotated[int, option(read_pictures, "N")] = 20
    """Number of pictures."""
    image_wh: ImageWh | None = None
    """Picture size in pixels, such as 800x600; default: as in the scene."""
    seed: Seed = 0
    """Random seed for the poses of the board and the noise: 0, 1, 2, ..."""


def board(*, output: OutputFile, page: PageOptions = PageOptions(), drawn: BoardOptions = BoardOptions()) -> None:
    """Write the calibration board for printing at true scale.

    The board (a ChArUco pattern of squares and markers) is written as a PDF or SVG page, with a ruler for checking the
    scale of the print. A board file (.toml) of the same name describes the board for 'calibrate camera'.

    Parameters
    ----------
    output : Path
        File to write, .pdf or .svg; must not exist yet.
    page : PageOptions
        Paper.
    drawn : BoardOptions
        Dimensions of the board.

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
        raise UserError(f"the board file {described} already exists; choose another name, or remove the file")
    title = f"ChArUco board, {made.squares_xy[0]}x{made.squares_xy[1]} squares of {made.square_mm:g} mm"
    write_pages([board_page(made, paper=page.paper())], output, title=title)
    save_board(made, described)
    print(f"wrote {output} ({title}) and its board file {described}")
    print("print the board at 100 % scale, glue it onto a flat plate, and take about 20 pictures of it")
    print(f"next: rhizotwin calibrate camera PICTURES --board {described} -o my_lens")


def camera(
    pictures: Annotated[Path, with_metavar("PICTURES")],
    /,
    *,
    output: OutputFolder,
    board: Annotated[Path | None, with_metavar("FILE")] = None,
    drawn: BoardOptions = BoardOptions(),
    scene: SceneName | None = None,
    progress: Progress = Progress(),
) -> None:
    """Fit the lens to pictures of the calibration board.

    Focal length, principal point and distortion are estimated from pictures of the board. Take all pictures with the
    focus that is used for scanning. Pictures that cannot be used are listed with the reason. The output folder contains
    camera.toml (the lens, for the [camera] section of scene files), calibration.json (all numbers) and report.html
    (residuals, coverage and all pictures).

    Parameters
    ----------
    pictures : Path
        Folder of pictures of the board (PNG, JPG, TIFF), all of the same size.
    output : Path
        New or empty output folder.
    board : Path, optional
        Board file, written by 'calibrate board'; default: board.toml in the folder of the pictures if it exists,
        otherwise the options for the board.
    drawn : BoardOptions
        Dimensions of the board, if there is no board file.
    scene : str, optional
        Scene (name or file), of which a copy with the calibrated lens is written to scene.toml. The pictures must
        have the picture size of the scene.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin calibrate camera my_board_pictures --board board.toml -o my_lens
    rhizotwin calibrate camera my_board_pictures --squares 7x5 --square-mm 30 -o my_lens --scene my_scene.toml
    """
    from rhizotwin.importer.picture_files import list_pictures
    from rhizotwin.rig.lens.calibration import calibrate as fit
    from rhizotwin.rig.lens.calibration import write_calibration
    from rhizotwin.rig.lens.calibration_report import write_report
    from rhizotwin.scenes.folders import new_folder

    paths = list_pictures(pictures)
    given = None if scene is None else files.load_scene(scene)
    shown = drawn.board_of(board or _board_beside(pictures, drawn))
    with progress.bar(boards=1.0) as bar:
        made = fit(paths, shown, monitor=bar)
    calibrated = None if given is None else _with_lens(given, made.camera)
    with new_folder(output) as building:
        written = [*write_calibration(made, building), write_report(made, building)]
        if calibrated is not None:
            files.save_scene(calibrated, building / "scene.toml")
            written.append(building / "scene.toml")
        names = [path.name for path in written]
    _print_calibration(made, given=shown, of=len(paths))
    for name in names:
        print(f"  {output / name}")


def _board_beside(pictures: Path, drawn: BoardOptions) -> Path | None:
    """Return the path of the file board.toml in the folder of the pictures.

    The result is None if the file is missing, or if the board is described by options instead.
    """
    beside = pictures / "board.toml"
    if drawn.given() or not beside.is_file():
        return None
    print(f"using the board file {beside}")
    return beside


def _print_calibration(made: "Calibration", *, given: "CharucoBoard", of: int) -> None:
    """Print the estimated lens parameters, and the pictures that were excluded.

    ``given`` is the board as stated, and ``of`` the total number of pictures.
    """
    if made.board != given:
        pattern, value = ("before", "true") if made.board.legacy_pattern else ("since", "false")
        print(f"note: the board has the pattern of OpenCV {pattern} 4.6; write legacy_pattern = {value} into the board file")
    for name, reason in made.rejected.items():
        print(f"excluded picture: {name}: {reason}")
    for warning in made.warnings:
        print(f"warning: {warning}")
    from rhizotwin.rig.lens.calibration import model_text

    lens, found = made.camera, made.fit
    std_x, std_y = found.principal_std_px
    print(f"focal length {lens.focal_px[0]:.2f}, {lens.focal_px[1]:.2f} px (standard deviation {found.focal_std_px[0]:.2f} px)")
    print(f"principal point {lens.principal_px[0]:.2f}, {lens.principal_px[1]:.2f} px (standard deviations {std_x:.2f}, {std_y:.2f} px)")
    print(f"fitted: {model_text(found)}")
    print(f"RMS residual {found.rms_px:.3f} px of {found.corners} corners in {len(found.views)} of {of} pictures")


def transfer(
    pictures: Annotated[Path, with_metavar("PICTURES")],
    /,
    *,
    output: OutputFile,
    exposures_s: Annotated[str | None, with_metavar("S,S,...")] = None,
) -> None:
    """Measure the response curve of the camera from an exposure series.

    The response curve is the relation between light and pixel values. Take at least five pictures of a motionless
    subject with many grey levels, such as the canister in front of the lit panel, from strongly underexposed to
    strongly overexposed; raw files are read, too. Change only the exposure time. The command fails if the pixel values
    are no function of the light (residual above 1 %). Paste the contents of the output file into the [camera] section
    of the scene file.

    Parameters
    ----------
    pictures : Path
        Folder of the pictures, sorted by name.
    output : Path
        File to write (.toml); must not exist yet.
    exposures_s : str, optional
        Exposure times in seconds, separated by commas, in the order of the pictures; default: as in the EXIF data of
        the pictures.

    Examples
    --------
    rhizotwin calibrate transfer my_exposures -o my_transfer.toml
    rhizotwin calibrate transfer my_exposures --exposures-s 0.002,0.004,0.008,0.016 -o my_transfer.toml
    """
    from rhizotwin.importer.picture_files import SUFFIXES, list_pictures
    from rhizotwin.rig.cameras import raw_files
    from rhizotwin.rig.lens.transfer_fit import fit_transfer
    from rhizotwin.rig.lens.transfer_series import read_series, transfer_text
    from rhizotwin.scenes.atomic import write_text

    if output.exists():
        raise UserError(f"{output} already exists; choose another name, or remove the file")
    images, times = read_series(list_pictures(pictures, suffixes=(*SUFFIXES, *raw_files.SUFFIXES)), exposures_s)
    found = fit_transfer(images, times)
    write_text(output, transfer_text(found, len(images)))
    low, high = found.reached
    print(f"response curve: {found.curve.name}, measured from {100.0 * low:.0f} to {100.0 * high:.0f} % of full scale")
    print(f"RMS residual {100.0 * found.residual:.1f} % of the light, {count(len(images), 'picture')}, {min(times):g} to {max(times):g} s")
    if found.rounded:
        print("the exposure times are rounded values of a shutter scale (1/60 s is 1/64 s); the true times were used")
    print(f"wrote {output}: paste its contents into the [camera] section of the scene file")


def simulate(
    scene: SceneName,
    /,
    *,
    output: OutputPictures,
    taken: BoardPictures = BoardPictures(),
    drawn: BoardOptions = BoardOptions(),
    computing: Computing = Computing(),
) -> None:
    """Render pictures of the calibration board with the camera of a scene.

    The board is rendered at the working distance of the camera, with the lens distortion, blur and noise of a profile.
    The true lens parameters are written to truth/camera.json and the board file to board.toml, both in the output
    folder.

    Parameters
    ----------
    scene : str
        Scene, which describes the camera: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        New or empty output folder.
    taken : BoardPictures
        Options of the pictures.
    drawn : BoardOptions
        Dimensions of the board.
    computing : Computing
        Device of the computation, and progress output.

    Examples
    --------
    rhizotwin calibrate simulate printed_8ml -o my_board_pictures --profile bench
    rhizotwin calibrate camera my_board_pictures -o my_lens
    """
    changed = change_scene(files.load_scene(scene), SceneChanges(image_wh=taken.image_wh, profile=taken.profile))
    made = drawn.board()
    command_steps.start_engine(computing.device, quiet=computing.quiet)
    from rhizotwin.sim.board import simulate_board

    with computing.bar(render=1.0) as bar:
        simulate_board(changed, made, output, pictures=taken.pictures, seed=taken.seed, monitor=bar)
    print(f"wrote {count(taken.pictures, 'picture')} of the board to {output}, and the true lens to {output / 'truth' / 'camera.json'}")
    print(f"next: rhizotwin calibrate camera {output} -o my_lens")


def _with_lens(scene: Scene, found: Camera) -> Scene:
    """Return a copy of the scene with the calibrated lens.

    The bit depth, response curve and bands of the scene's camera are retained.
    """
    if scene.camera.image_wh != found.image_wh:
        (wide, high), (width, height) = scene.camera.image_wh, found.image_wh
        raise UserError(
            f"the camera of scene {scene.name} has {wide}x{high} pixels, but the pictures of the board have {width}x{height}; "
            "change camera.image_wh, or take the pictures of the board at the size used for scanning"
        )
    lens = replace(scene.camera, kind=found.kind, focal_px=found.focal_px, principal_px=found.principal_px, distortion=found.distortion)
    calibrated = replace(scene, camera=lens)
    check_scene(calibrated, where=f"scene {scene.name} with the calibrated camera")
    return calibrated
