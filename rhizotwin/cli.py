"""The command line: its words, its help, and how each failure ends in one sentence."""

import argparse
import errno
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn, TypeAlias, TypeVar

from scenes.errors import UserError

T = TypeVar("T")

EXIT_FAILED, EXIT_MISTAKE, EXIT_STOPPED = 1, 2, 130
DEFAULT_VOXEL_MM = 0.27
VOXEL_LIMITS_MM = (0.01, 10.0)
DIAMETER_LIMITS_MM = (0.01, 50.0)
PIXEL_LIMITS = (16, 20000)
MAX_VIEWS = 10000
DEBUG_VARIABLE = "RHIZOTWIN_DEBUG"
AFTER_STOP = {
    "simulate": "the same command takes it up again",
    "demo": "the same command takes it up again",
    "plan": "the same command takes it up again",
    "scan": "the pictures are kept; the same command with --resume takes the others",
    "twin": "",
    "rig": "",
    "camera": "",
}
"""What Ctrl-C leaves of a command; of the others nothing."""
ONE_STOP_S = 1.0
"""Ctrl-C pressed again within this time is the same press: it must not disturb the tidying up."""
ASK_AGAIN_S = 0.05
"""Ctrl-C while a library is loading waits for it: after this time it is looked again."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise the complaint for `main` to print."""
        raise UserError(f"{message}; see {self.prog} --help")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done, 1 failed, 2 what the user can put right, 130 stopped by Ctrl-C."""
    stops: list[float] = []
    command = ""

    def stop(_: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if _loading(frame):
            signal.setitimer(signal.ITIMER_REAL, ASK_AGAIN_S)
        elif not stops or now - stops[-1] > ONE_STOP_S:
            stops.append(now)
            raise KeyboardInterrupt

    in_main_thread = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM) if in_main_thread}
    try:
        options = build_parser().parse_args(arguments)
        command = options.command
        from rhizotwin import commands  # what it needs takes time to load, and --help should not

        commands.run(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output (head, less) has left: nobody is there to be told.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - the last line of defence: nobody sees a traceback unasked
        # A library that is stopped while it loads may report an error of its own instead.
        return _fail(*_explain(KeyboardInterrupt() if stops else error, command))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _loading(frame: FrameType | None) -> bool:
    """Tell whether Python is loading a module: libraries that are stopped then swallow it, or report an error of their own."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _fail(sentence: str, code: int) -> int:
    if "tqdm" in sys.modules:  # the sentence begins on a line of its own, not behind an unfinished bar
        for bar in list(getattr(sys.modules["tqdm"].tqdm, "_instances", ())):
            bar.close()
    if code == EXIT_STOPPED and sys.stderr.isatty():
        sys.stderr.write("\n")  # behind the terminal's ^C
    if os.environ.get(DEBUG_VARIABLE):
        traceback.print_exc()
    sys.stderr.write(f"rhizotwin: {' '.join(sentence.split())}\n")
    return code


def _explain(error: BaseException, command: str) -> tuple[str, int]:
    """Return the sentence that explains an error in a command, and the exit code."""
    if isinstance(error, KeyboardInterrupt):
        after = AFTER_STOP.get(command, "nothing was written; run it again")
        return f"stopped; {after}" if after else "stopped", EXIT_STOPPED
    if isinstance(error, UserError):
        return str(error), EXIT_MISTAKE
    if isinstance(error, MemoryError):
        return "not enough memory; use larger voxels (--voxel-mm) or smaller pictures", EXIT_FAILED
    text = " ".join(str(error).split())[:300]
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return f"{where}the disk is full; free some space and run the same command again", EXIT_MISTAKE
        return f"{where}{error.strerror or text}; check the path and your rights to it", EXIT_FAILED
    what = f"stopped by an unexpected error ({type(error).__name__}: {text})"
    return f"{what}; run it again with {DEBUG_VARIABLE}=1 to see where", EXIT_FAILED


def build_parser() -> Parser:
    """Return the parser of the whole command line; loads nothing heavy."""
    parser = Parser(
        prog="rhizotwin",
        description="A digital twin of a hydroponic root-imaging rig: render roots in a refracting water canister, reconstruct them "
        "from the pictures alone, and score the result against the truth.",
        epilog="Start with: rhizotwin demo\n"
        "Then the three steps by themselves:\n"
        "  rhizotwin simulate printed_8ml -o my_dataset\n"
        "  rhizotwin reconstruct my_dataset -o my_result\n"
        "  rhizotwin score my_result my_dataset\n"
        "Each command has a --help of its own. Lengths are millimetres, angles degrees.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_scenes(commands)
    _add_simulate(commands)
    _add_reconstruct(commands)
    _add_import(commands)
    _add_score(commands)
    _add_export(commands)
    _add_plan(commands)
    _add_demo(commands)
    from rhizotwin import print_cli, rig_cli  # they take their helpers from here

    print_cli.add(commands)
    rig_cli.add(commands)
    return parser


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def _add(commands: Commands, name: str, short: str, *, description: str, epilog: str) -> Parser:
    return commands.add_parser(
        name, help=short, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def _add_scenes(commands: Commands) -> None:
    parser = _add(
        commands,
        "scenes",
        "list the scenes and disturbance profiles that come with the program",
        description="List the library of scenes, one line each. With a name and -o, write that scene's file instead, with every setting,\n"
        "to be changed and given to the other commands as a scene of your own.",
        epilog="examples:\n"
        "  rhizotwin scenes\n"
        "  rhizotwin scenes sphere_20mm -o my_scene.toml\n"
        "  rhizotwin simulate my_scene.toml -o my_dataset",
    )
    parser.add_argument("name", nargs="?", metavar="SCENE", help="a scene's name, or a scene file: write a copy of it")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="file to write the copy to (TOML); must not exist yet")


def _add_simulate(commands: Commands) -> None:
    parser = _add(
        commands,
        "simulate",
        "render a scene to a dataset, with its truth",
        description="Render every view of a scene's capture plan to a dataset folder: pictures as the camera would take them, and the\n"
        "truth beside them. Stopped half-way, the same command goes on where it stopped.",
        epilog="examples:\n"
        "  rhizotwin simulate printed_8ml -o my_dataset\n"
        "  rhizotwin simulate printed_8ml -o my_dataset --profile bench --views 24 --image-wh 400x300\n"
        "  rhizotwin simulate sphere_20mm -o my_dataset --specimen my_root.stl\n"
        "  rhizotwin simulate sphere_20mm -o my_dataset --specimen my_roots.rsml --specimen-unit cm --specimen-diameter-mm 0.5",
    )
    parser.add_argument("scene", metavar="SCENE", help="a name from 'rhizotwin scenes', or a scene file (TOML)")
    _add_output(parser, "DATASET", "folder to make the dataset in: new, empty, or left by the same command when it was stopped")
    parser.add_argument(
        "--profile",
        metavar="clean|bench|harsh",
        help="what the rig gets wrong: clean (nothing), bench (a good rig), harsh (a bad day), or a file; default: the scene's own",
    )
    parser.add_argument(
        "--specimen",
        type=Path,
        metavar="FILE",
        help="put this in place of the scene's root: a closed mesh (PLY, STL, OBJ) or traced roots (RSML), in millimetres in the canister "
        "frame: origin on the axis in the plane of the rim, z up, roots below 0",
    )
    parser.add_argument(
        "--specimen-unit",
        metavar="UNIT",
        help="unit of an RSML file's coordinates, where the file does not say or is wrong: mm, cm, m, um, inch, or a step such as '0.1 mm'",
    )
    parser.add_argument(
        "--specimen-diameter-mm", type=_diameter_mm, metavar="D", help="diameter of the roots for which an RSML file gives none"
    )
    parser.add_argument("--views", type=_views, metavar="N", help="pictures in every ring; default: the scene's")
    parser.add_argument("--image-wh", type=_image_wh, metavar="WxH", help="picture size in pixels, such as 800x600; default: the scene's")
    parser.add_argument(
        "--fidelity",
        choices=("backlit", "path"),
        default="backlit",
        help="backlit: fast, without noise of its own; path: full path tracing with all reflections, slower; default: %(default)s",
    )
    parser.add_argument(
        "--samples", type=_samples, metavar="N", help="light paths a pixel: more is slower and smoother; default: as the fidelity needs"
    )
    parser.add_argument(
        "--seed", type=_seed, default=0, metavar="S", help="of every error and noise that is drawn: 0, 1, 2, ...; default: %(default)s"
    )
    _add_device(parser)


def _add_reconstruct(commands: Commands) -> None:
    parser = _add(
        commands,
        "reconstruct",
        "find the root's shape and volume in a dataset's pictures",
        description="Find the cameras from the marker strip, the silhouettes from the pictures, and the root's shape and volume from\n"
        "both. The truth of a simulated dataset is only drawn beside the result, never used.",
        epilog="examples:\n  rhizotwin reconstruct my_dataset -o my_result\n  rhizotwin reconstruct my_dataset -o my_result --voxel-mm 0.1",
    )
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder made by 'rhizotwin simulate' or 'rhizotwin import'")
    _add_output(parser, "RESULT", "folder to write the result to: new, empty, or an earlier result, which is replaced")
    parser.add_argument(
        "--voxel-mm",
        type=_voxel_mm,
        default=DEFAULT_VOXEL_MM,
        metavar="MM",
        help=f"edge of the smallest voxels, {VOXEL_LIMITS_MM[0]:g} to {VOXEL_LIMITS_MM[1]:g} mm; "
        "smaller is slower and finer; default: %(default)s",
    )
    _add_device(parser)


def _add_import(commands: Commands) -> None:
    parser = _add(
        commands,
        "import",
        "make a dataset of a folder of pictures taken elsewhere",
        description="Make a dataset of pictures taken elsewhere (PNG, JPG or TIFF, of one size), in the natural order of their names.\n"
        "The scene describes the rig they were taken on: canister, water, strip, camera. If the scene's plan has as many views as\n"
        "there are pictures, its table angles are assumed.",
        epilog="examples:\n"
        "  rhizotwin import my_pictures --scene my_rig.toml -o my_dataset\n"
        "  rhizotwin import my_masks --scene my_rig.toml --cameras transforms.json --masks -o my_dataset",
    )
    parser.add_argument("pictures", type=Path, metavar="PICTURES", help="folder of pictures")
    parser.add_argument("--scene", required=True, metavar="SCENE", help="a scene file (TOML) or a name from 'rhizotwin scenes'")
    _add_output(parser, "DATASET", "folder to make the dataset in: new or empty")
    parser.add_argument(
        "--cameras",
        type=Path,
        metavar="JSON",
        help="poses and lens in nerfstudio's form (transforms.json), its world the canister frame in millimetres: "
        "no markers are needed then",
    )
    parser.add_argument(
        "--masks",
        action="store_true",
        help="the pictures are silhouettes already: white root on black; needs --cameras, they show no markers",
    )


def _add_score(commands: Commands) -> None:
    parser = _add(
        commands,
        "score",
        "compare a result with the truth of a simulated dataset",
        description="Compare a result with the truth: volume, extents, voxels, surface distances, and poses and silhouettes stage\n"
        "by stage. Errors are signed fractions: found / true - 1.",
        epilog="examples:\n  rhizotwin score my_result my_dataset\n  rhizotwin score my_result my_dataset --json > score.json",
    )
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder made by 'rhizotwin reconstruct'")
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="the simulated dataset that the result was made from")
    parser.add_argument("--json", action="store_true", help="print every number as JSON instead of a table")


def _add_export(commands: Commands) -> None:
    parser = _add(
        commands,
        "export",
        "write a result in the files of other programs",
        description="Write a result's surface (.ply, .stl in mm; .glb in metres, y up), its voxels (.nrrd: 0 to 255 is the share of\n"
        "root, mm), or its cameras (.json: nerfstudio's transforms.json; a name without suffix: a folder with COLMAP's text model).\n"
        "Cameras are those in air: the roots are seen through the wall and the water, which straight rays do not follow.",
        epilog="examples:\n  rhizotwin export my_result -o root.stl\n  rhizotwin export my_result -o root.nrrd\n"
        "  rhizotwin export my_result --dataset my_dataset -o transforms.json",
    )
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder made by 'rhizotwin reconstruct'")
    _add_output(parser, "FILE", "what to write; its suffix says in which form")
    parser.add_argument("--dataset", type=Path, metavar="DATASET", help="the dataset that the result was made from; cameras need its lens")


def _add_plan(commands: Commands) -> None:
    parser = _add(
        commands,
        "plan",
        "try capture plans on the twin before building or scanning",
        description="Simulate, reconstruct and score a scene with every combination of the given numbers of views, camera heights and\n"
        "picture sizes, and say what each reaches: a table, plan.csv, plan.json and a figure, plan.png. A stopped run is taken up by the\n"
        "same command. Each combination takes about a minute for 40 pictures of 800x600 on two cores.",
        epilog="examples:\n  rhizotwin plan radish_day15a -o my_plan --views 20,40,41\n"
        "  rhizotwin plan printed_8ml -o my_plan --views 21,41 --heights=-42 --heights=-100,-42 --within 3\n"
        "  rhizotwin plan my_scene.toml -o my_plan --image-wh 800x600,1600x1200 --profile bench --seeds 3",
    )
    parser.add_argument("scene", metavar="SCENE", help="a scene file (TOML) or a name from 'rhizotwin scenes'")
    _add_output(parser, "FOLDER", "folder for the table, the figure and the scores: new, or of an earlier plan")
    parser.add_argument(
        "--views", type=_list_of(_views), default=(20, 40, 41), metavar="N,N,...", help="views in a ring to try; default: 20,40,41"
    )
    parser.add_argument(
        "--heights",
        type=_list_of(_height_mm),
        action="append",
        metavar="=MM,MM,...",
        help="heights of the camera over the canister's rim, one a ring, all looking at the same point; once for each set to try; default: "
        "the scene's first ring, and it with a second one 60 mm lower",
    )
    parser.add_argument("--image-wh", type=_list_of(_image_wh), metavar="WxH,WxH,...", help="picture sizes to try; default: the scene's")
    parser.add_argument(
        "--profile", default="bench", metavar="NAME", help="what the rig gets wrong: clean, bench, harsh or a file; default: %(default)s"
    )
    parser.add_argument("--seeds", type=_seeds, default=1, metavar="N", help="runs of each plan with other errors; default: %(default)s")
    parser.add_argument(
        "--within",
        type=_percent,
        default=5.0,
        metavar="PERCENT",
        help="name the cheapest plan whose volume stays within this; default: %(default)s",
    )
    _add_device(parser)


def _add_demo(commands: Commands) -> None:
    parser = _add(
        commands,
        "demo",
        "all three steps on a small printed root: a few minutes",
        description="Simulate a small printed root, reconstruct it from the pictures alone, score it, and make pictures of what was found.",
        epilog="examples:\n  rhizotwin demo\n  rhizotwin demo -o my_demo --profile bench",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("demo"),
        metavar="FOLDER",
        help="folder for everything; a finished demo in it is replaced, a stopped one taken up; default: %(default)s",
    )
    parser.add_argument("--profile", default="clean", metavar="clean|bench|harsh", help="what the rig gets wrong; default: %(default)s")
    _add_device(parser)


def _add_output(parser: Parser, name: str, text: str) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=name, help=text)


def _add_device(parser: Parser) -> None:
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="what computes: cpu, cuda (an NVIDIA card), auto (the card if there is one); default: %(default)s",
    )


def _whole(text: str, low: int, high: int, what: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is out of range, {what}")
    return value


def _views(text: str) -> int:
    return _whole(text, 1, MAX_VIEWS, f"give 1 to {MAX_VIEWS}")


def _samples(text: str) -> int:
    return _whole(text, 1, 1 << 16, f"give 1 to {1 << 16}")


def _seeds(text: str) -> int:
    return _whole(text, 1, 1000, "give 1 to 1000")


def _height_mm(text: str) -> float:
    return _between(text, (-2000.0, 2000.0), "mm")


def _percent(text: str) -> float:
    return _between(text, (0.01, 1000.0), "%")


def _list_of(one: Callable[[str], T]) -> Callable[[str], tuple[T, ...]]:
    """Return a reader of a list with commas."""

    def read(text: str) -> tuple[T, ...]:
        return tuple(dict.fromkeys(one(part) for part in text.split(",")))

    return read


def _seed(text: str) -> int:
    return _whole(text, 0, 2**63 - 1, "give 0 or a positive whole number")


def _image_wh(text: str) -> tuple[int, int]:
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a picture size, write it as 800x600")
    low, high = PIXEL_LIMITS
    if not all(low <= side <= high for side in (int(width), int(height))):
        raise argparse.ArgumentTypeError(f"{text} is out of range, give {low} to {high} pixels a side")
    return int(width), int(height)


def _voxel_mm(text: str) -> float:
    return _millimetres(text, VOXEL_LIMITS_MM)


def _diameter_mm(text: str) -> float:
    return _millimetres(text, DIAMETER_LIMITS_MM)


def _millimetres(text: str, limits: tuple[float, float]) -> float:
    return _between(text, limits, "mm", "millimetres")


def _between(text: str, limits: tuple[float, float], unit: str, units: str | None = None) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of {units or unit}") from None
    low, high = limits
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is out of range, give {low:g} to {high:g} {unit}")
    return value
