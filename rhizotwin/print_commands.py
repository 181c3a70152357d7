"""What ``markers`` and ``calibrate`` do; the work itself is in `rig` and `sim`."""

import argparse
from dataclasses import replace
from pathlib import Path

from rhizotwin.picture_files import list_pictures
from rhizotwin.rig.printing.print_page import PAGES_MM, Paper
from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import new_folder
from rhizotwin.scenes.board import MARKER_SHARE, CharucoBoard, check_board, load_board, save_board
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.steps import change_scene, start_engine

BOARD_OPTIONS = ("squares", "square_mm", "marker_mm", "dictionary")


def markers(options: argparse.Namespace) -> None:
    """Write the marker strip for the printer."""
    from rhizotwin.rig.printing.print_files import write_pages
    from rhizotwin.rig.printing.print_strip import strip_pages

    scene = files.load_scene(options.scene)
    written = write_pages(
        strip_pages(scene, paper=_paper(options), paper_mm=options.paper_mm), options.output, title=f"marker strip of {scene.name}"
    )
    across_mm = 2.0 * scene.net_pot.outer_radius_mm
    print(f"the strip of {scene.name} in {', '.join(str(path) for path in written)}")
    print(f"print at 100 %, measure the ruler, cut, glue; over the paper it must measure {across_mm:.1f} mm across the pot")


def calibrate(options: argparse.Namespace) -> None:
    """Do one step of a calibration."""
    {"board": board, "camera": camera, "simulate": simulate}[options.step](options)


def board(options: argparse.Namespace) -> None:
    """Write the calibration board for the printer, and the file that describes it."""
    from rhizotwin.rig.printing.print_board import board_page
    from rhizotwin.rig.printing.print_files import write_pages

    made = _board_of(options)
    described: Path = options.output.with_suffix(".toml")
    if described.exists():
        raise UserError(f"{described} exists already, and the board's description would be written there; choose another name or remove it")
    title = f"ChArUco board, {made.squares_xy[0]}x{made.squares_xy[1]} squares of {made.square_mm:g} mm"
    write_pages([board_page(made, paper=_paper(options))], options.output, title=title)
    save_board(made, described)
    print(f"{title}: {options.output}, described by {described}")
    print("print at 100 %, glue it on something flat, take about 20 pictures of it")
    print(f"next: rhizotwin calibrate camera PICTURES --board {described} -o my_lens")


def camera(options: argparse.Namespace) -> None:
    """Fit the lens to pictures of the board."""
    from rhizotwin.rig.lens.calibration import calibrate as fit
    from rhizotwin.rig.lens.calibration import model_text, write_calibration
    from rhizotwin.rig.lens.calibration_report import write_report

    paths = list_pictures(options.pictures)
    scene = None if options.scene is None else files.load_scene(options.scene)
    made = fit(paths, _board_of(options, beside=options.pictures / "board.toml"), progress=True)
    calibrated = None if scene is None else _with_camera(scene, made.camera)
    with new_folder(options.output) as building:
        written = [*write_calibration(made, building), write_report(made, building)]
        if calibrated is not None:
            files.save_scene(calibrated, building / "scene.toml")
            written.append(building / "scene.toml")
        names = [path.name for path in written]
    for name, reason in made.rejected.items():
        print(f"left out {name}: {reason}")
    for warning in made.warnings:
        print(f"warning: {warning}")
    lens, found = made.camera, made.fit
    std_x, std_y = found.principal_std_px
    print(f"focal length {lens.focal_px[0]:.2f}, {lens.focal_px[1]:.2f} px (standard deviation {found.focal_std_px[0]:.2f} px)")
    print(f"principal point {lens.principal_px[0]:.2f}, {lens.principal_px[1]:.2f} px (standard deviations {std_x:.2f}, {std_y:.2f} px)")
    print(f"fitted: {model_text(found)}")
    print(f"residual {found.rms_px:.3f} px rms of {found.corners} corners in {len(found.views)} of {len(paths)} pictures")
    for name in names:
        print(f"  {options.output / name}")


def simulate(options: argparse.Namespace) -> None:
    """Render pictures of the board."""
    scene = change_scene(files.load_scene(options.scene), image_wh=options.image_wh, profile=options.profile)
    made = _board_of(options)
    start_engine(options)
    from rhizotwin.sim.board import simulate_board

    simulate_board(scene, made, options.output, pictures=options.pictures, seed=options.seed)
    print(f"{options.pictures} pictures of the board in {options.output}, the true lens in {options.output / 'truth' / 'camera.json'}")
    print(f"next: rhizotwin calibrate camera {options.output} -o my_lens")


def _paper(options: argparse.Namespace) -> Paper:
    if isinstance(options.page, str):
        return Paper(size_mm=PAGES_MM[options.page], turn=options.turn or "either", printed_ruler_mm=options.printed_ruler_mm)
    return Paper(size_mm=options.page, turn=options.turn or "as given", printed_ruler_mm=options.printed_ruler_mm)


def _board_of(options: argparse.Namespace, *, beside: Path | None = None) -> CharucoBoard:
    """Return the board that the options describe, or the file that does."""
    given = [name for name in BOARD_OPTIONS if getattr(options, name) is not None]
    path: Path | None = getattr(options, "board", None)
    if path is not None:
        if given:
            raise UserError(f"--board {path} describes the whole board; leave --{given[0].replace('_', '-')} out, or --board")
        return load_board(path)
    if beside is not None and not given and beside.is_file():
        print(f"the board is as {beside} says")
        return load_board(beside)
    default = CharucoBoard()
    square_mm = options.square_mm or default.square_mm
    made = CharucoBoard(
        squares_xy=options.squares or default.squares_xy,
        square_mm=square_mm,
        marker_mm=options.marker_mm or round(square_mm * MARKER_SHARE, 3),
        dictionary=options.dictionary or default.dictionary,
    )
    return check_board(made, where="the board")


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
