"""The words of the command line for what is printed, and for calibrating the camera."""

import argparse
from pathlib import Path

from rhizotwin.arguments import Commands, Parser, add_command, add_device, add_output, image_wh, millimetres, seed, whole

PAGES = ("a4", "a3", "letter")
PAGE_LIMITS_MM = (50.0, 5000.0)
RULER_LIMITS_MM = (90.0, 110.0)
PAPER_LIMITS_MM = (0.0, 2.0)
SQUARE_LIMITS_MM = (1.0, 1000.0)
SQUARES_LIMITS = (3, 60)
PICTURES_LIMITS = (3, 1000)
PrintedRuler = tuple[float, float]


def add(commands: Commands) -> None:
    """Add ``markers`` and ``calibrate`` to the command line."""
    _add_markers(commands)
    parser = add_command(
        commands,
        "calibrate",
        "print a calibration board, and find the camera's lens from pictures of it",
        description="Three steps: print the board, take about 20 pictures of it, and fit the lens to them. 'simulate' renders such\n"
        "pictures with a scene's camera, to try it out.",
        epilog="examples:\n"
        "  rhizotwin calibrate board -o board.pdf\n"
        "  rhizotwin calibrate camera my_board_pictures --board board.toml -o my_lens\n"
        "  rhizotwin calibrate simulate printed_8ml -o my_board_pictures --profile bench",
    )
    steps = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    _add_board(steps)
    _add_camera(steps)
    _add_simulate(steps)


def _add_markers(commands: Commands) -> None:
    parser = add_command(
        commands,
        "markers",
        "write the marker strip of a scene for the printer, at true scale",
        description="Write the marker strip of a scene as PDF or SVG pages at true scale, with cut marks, glue tabs and a ruler to check\n"
        "the printer by. Several SVG pages become strip-1.svg, strip-2.svg, ...",
        epilog="examples:\n"
        "  rhizotwin markers printed_8ml -o strip.pdf\n"
        "  rhizotwin markers my_scene.toml -o strip.svg --page a3 --landscape\n"
        "  rhizotwin markers my_scene.toml -o strip.pdf --printed-ruler-mm 99.6x99.8",
    )
    parser.add_argument("scene", metavar="SCENE", help="a name from 'rhizotwin scenes', or a scene file (TOML)")
    add_output(parser, "FILE", "file to write, .pdf or .svg; must not exist yet")
    _add_page(parser)
    parser.add_argument(
        "--paper-mm",
        type=lambda text: millimetres(text, PAPER_LIMITS_MM),
        default=0.1,
        metavar="MM",
        help="thickness of what is printed on: net_pot.outer_radius_mm is the radius over it; default: %(default)s",
    )


def _add_board(steps: Commands) -> None:
    parser = add_command(
        steps,
        "board",
        "write the calibration board for the printer, at true scale",
        description="Write a ChArUco board as one PDF or SVG page at true scale, with a ruler to check the printer by, and beside it,\n"
        "under the same name, a board file (.toml) that tells 'calibrate camera' what was printed.",
        epilog="examples:\n"
        "  rhizotwin calibrate board -o board.pdf\n"
        "  rhizotwin calibrate board -o board.svg --page a3 --squares 9x7 --square-mm 35",
    )
    add_output(parser, "FILE", "file to write, .pdf or .svg; must not exist yet")
    _add_page(parser)
    _add_squares(parser)


def _add_camera(steps: Commands) -> None:
    parser = add_command(
        steps,
        "camera",
        "fit the lens to pictures of the calibration board",
        description="Find focal length, principal point and distortion from pictures of the board, all taken at the focus of the scan.\n"
        "Pictures that cannot be used are named with the reason. Writes camera.toml (a [camera] section for scene files),\n"
        "calibration.json (every number) and report.html (residuals, coverage, each picture).",
        epilog="examples:\n"
        "  rhizotwin calibrate camera my_board_pictures --board board.toml -o my_lens\n"
        "  rhizotwin calibrate camera my_board_pictures --squares 7x5 --square-mm 30 -o my_lens --scene my_scene.toml",
    )
    parser.add_argument("pictures", type=Path, metavar="PICTURES", help="folder of pictures (PNG, JPG, TIFF) of the board, of one size")
    add_output(parser, "FOLDER", "folder to write to: new or empty")
    parser.add_argument(
        "--board",
        type=Path,
        metavar="FILE",
        help="board file that was written with the board; default: board.toml in PICTURES if it is there, else the sizes below",
    )
    _add_squares(parser)
    parser.add_argument(
        "--scene",
        metavar="SCENE",
        help="also write scene.toml: this scene with the calibrated camera; its picture size must be the pictures'",
    )


def _add_simulate(steps: Commands) -> None:
    parser = add_command(
        steps,
        "simulate",
        "render pictures of the calibration board with a scene's camera",
        description="Render pictures of the board before the scene's camera at its working distance, with the lens distortion, blur and\n"
        "noise of a profile. The true lens is in truth/camera.json, board.toml beside the pictures.",
        epilog="examples:\n"
        "  rhizotwin calibrate simulate printed_8ml -o my_board_pictures --profile bench\n"
        "  rhizotwin calibrate camera my_board_pictures -o my_lens",
    )
    parser.add_argument("scene", metavar="SCENE", help="a name from 'rhizotwin scenes', or a scene file (TOML)")
    add_output(parser, "PICTURES", "folder to write to: new or empty")
    parser.add_argument(
        "--profile", metavar="clean|bench|harsh", help="distortion, blur and noise of the camera, or a file; default: the scene's own"
    )
    parser.add_argument(
        "--pictures", type=lambda text: whole(text, *PICTURES_LIMITS, "give {} to {}".format(*PICTURES_LIMITS)), default=20, metavar="N",
        help="how many; default: %(default)s",
    )  # fmt: skip
    parser.add_argument("--image-wh", type=image_wh, metavar="WxH", help="picture size in pixels, such as 800x600; default: the scene's")
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of poses and noise: 0, 1, 2, ...; default: %(default)s")
    _add_squares(parser)
    add_device(parser)


def _add_page(parser: Parser) -> None:
    parser.add_argument(
        "--page", type=_page, default="a4", metavar="a4|a3|letter|WxH", help="paper, or its width and height in mm; default: %(default)s"
    )
    turn = parser.add_mutually_exclusive_group()
    turn.add_argument(
        "--landscape", dest="turn", action="store_const", const="landscape", help="lay the page across; default: what fits better"
    )
    turn.add_argument("--portrait", dest="turn", action="store_const", const="portrait", help="stand the page upright")
    parser.add_argument(
        "--printed-ruler-mm",
        type=_printed_ruler,
        default=(100.0, 100.0),
        metavar="MM|MMxMM",
        help="what 100 mm became on your printer, across and down the page, such as 99.6 or 99.6x99.8; put right in the drawing",
    )


def _add_squares(parser: Parser) -> None:
    parser.add_argument("--squares", type=_squares, metavar="CxR", help="squares of the board across and down; default: 7x5")
    parser.add_argument("--square-mm", type=_square_mm, metavar="MM", help="side of the squares; default: 30")
    parser.add_argument("--marker-mm", type=_square_mm, metavar="MM", help="side of the markers; default: 11/15 of the squares'")
    parser.add_argument("--dictionary", metavar="NAME", help="the markers' ArUco dictionary; default: 5X5_100")


def _page(text: str) -> str | tuple[float, float]:
    if text.lower() in PAGES:
        return text.lower()
    try:
        return _pair_mm(text, PAGE_LIMITS_MM)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no page, give one of {', '.join(PAGES)}, or width and height in mm as 297x210"
        ) from None


def _printed_ruler(text: str) -> PrintedRuler:
    try:
        return _pair_mm(text if "x" in text.lower() else f"{text}x{text}", RULER_LIMITS_MM)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not what 100 mm became, write it as 99.6, or 99.6x99.8 across and down") from None


def _pair_mm(text: str, limits: tuple[float, float]) -> tuple[float, float]:
    """Return two lengths written as 297x210; ValueError where it is not that."""
    first, second = text.lower().split("x")
    float(first), float(second)
    return millimetres(first, limits), millimetres(second, limits)


def _squares(text: str) -> tuple[int, int]:
    columns, cross, rows = text.lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of squares, write it as 7x5")
    low, high = SQUARES_LIMITS
    if not all(low <= side <= high for side in (int(columns), int(rows))):
        raise argparse.ArgumentTypeError(f"{text} is out of range, give {low} to {high} squares a side")
    return int(columns), int(rows)


def _square_mm(text: str) -> float:
    return millimetres(text, SQUARE_LIMITS_MM)
