"""The command line: its words, its help, and how each failure ends in one sentence."""

import argparse
import errno
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from rhizotwin.arguments import (
    VOXEL_LIMITS_MM,
    Commands,
    Parser,
    add_command,
    add_device,
    add_output,
    diameter_mm,
    height,
    image_wh,
    list_of,
    mass_g,
    percent,
    samples,
    seed,
    seeds,
    views,
    voxel_mm,
)
from rhizotwin.scenes.errors import UserError

EXIT_FAILED, EXIT_MISTAKE, EXIT_STOPPED = 1, 2, 130
DEFAULT_VOXEL_MM = 0.27
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
    from rhizotwin import print_cli, rig_cli, traits_cli

    traits_cli.add(commands)
    print_cli.add(commands)
    rig_cli.add(commands)
    return parser


def _add_scenes(commands: Commands) -> None:
    parser = add_command(
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
    parser = add_command(
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
    add_output(parser, "DATASET", "folder to make the dataset in: new, empty, or left by the same command when it was stopped")
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
        "--specimen-diameter-mm", type=diameter_mm, metavar="D", help="diameter of the roots for which an RSML file gives none"
    )
    parser.add_argument("--views", type=views, metavar="N", help="pictures in every ring; default: the scene's")
    parser.add_argument("--image-wh", type=image_wh, metavar="WxH", help="picture size in pixels, such as 800x600; default: the scene's")
    parser.add_argument(
        "--fidelity",
        choices=("backlit", "path"),
        default="backlit",
        help="backlit: fast, without noise of its own; path: full path tracing with all reflections, slower; default: %(default)s",
    )
    parser.add_argument(
        "--samples", type=samples, metavar="N", help="light paths a pixel: more is slower and smoother; default: as the fidelity needs"
    )
    parser.add_argument(
        "--seed", type=seed, default=0, metavar="S", help="of every error and noise that is drawn: 0, 1, 2, ...; default: %(default)s"
    )
    add_device(parser)


def _add_reconstruct(commands: Commands) -> None:
    parser = add_command(
        commands,
        "reconstruct",
        "find the root's shape and volume in a dataset's pictures",
        description="Find the cameras from the marker strip, the silhouettes from the pictures, and the root's shape and volume from\n"
        "both. The truth of a simulated dataset is only drawn beside the result, never used.",
        epilog="examples:\n"
        "  rhizotwin reconstruct my_dataset -o my_result\n"
        "  rhizotwin reconstruct my_dataset -o my_result --voxel-mm 0.1\n"
        "  rhizotwin reconstruct my_dataset -o my_result --mass-g 1.18",
    )
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder made by 'rhizotwin simulate' or 'rhizotwin import'")
    add_output(parser, "RESULT", "folder to write the result to: new, empty, or an earlier result, which is replaced")
    parser.add_argument(
        "--voxel-mm",
        type=voxel_mm,
        default=DEFAULT_VOXEL_MM,
        metavar="MM",
        help=f"edge of the smallest voxels, {VOXEL_LIMITS_MM[0]:g} to {VOXEL_LIMITS_MM[1]:g} mm; "
        "smaller is slower and finer; default: %(default)s",
    )
    parser.add_argument(
        "--mass-g", type=mass_g, metavar="G", help="mass of the roots, if weighed: gives specific root length and tissue density"
    )
    add_device(parser)


def _add_import(commands: Commands) -> None:
    parser = add_command(
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
    add_output(parser, "DATASET", "folder to make the dataset in: new or empty")
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
    parser = add_command(
        commands,
        "score",
        "compare a result with the truth of a simulated dataset",
        description="Compare a result with the truth: volume, extents, voxels, surface distances, and poses and silhouettes stage\n"
        "by stage, and every trait. Errors are signed fractions: found / true - 1; of angles, differences in degrees.",
        epilog="examples:\n  rhizotwin score my_result my_dataset\n  rhizotwin score my_result my_dataset --json > score.json",
    )
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder made by 'rhizotwin reconstruct'")
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="the simulated dataset that the result was made from")
    parser.add_argument("--json", action="store_true", help="print every number as JSON instead of a table")


def _add_export(commands: Commands) -> None:
    parser = add_command(
        commands,
        "export",
        "write a result in the files of other programs",
        description="Write a result for another program; the name's suffix says what:\n"
        "  .ply .stl   the surface, mm, z up (3D printing, MeshLab)\n"
        "  .glb        the surface, metres, y up as glTF asks (viewers, Blender)\n"
        "  .nrrd       voxels, 0 to 255 is the share of root, mm (3D Slicer, ImageJ)\n"
        "  .rsml       the roots' centre lines and diameters, mm, z up (CPlantBox, archiDART, OpenAlea)\n"
        "  .csv        the traits with units and definitions (spreadsheets, R)\n"
        "  .json       the cameras as nerfstudio's transforms.json, mm\n"
        "  no suffix   a folder with the cameras as COLMAP's text model, mm\n"
        "With --roots a mesh is the roots as tubes, coloured by order or diameter, instead of the surface; STL has no colours.\n\n"
        "Cameras are those in air, and the pictures were taken through a round wall and water, which magnify the roots by about a\n"
        "third and bend them. Programs that follow straight rays (photogrammetry, NeRF, Gaussian splatting) get wrong shapes of the\n"
        "roots from them, whatever the lens model; they are right for what is outside the canister.",
        epilog="examples:\n"
        "  rhizotwin export my_result -o root.stl\n"
        "  rhizotwin export my_result -o root.nrrd\n"
        "  rhizotwin export my_result -o roots.rsml\n"
        "  rhizotwin export my_result --roots diameter -o roots.glb\n"
        "  rhizotwin export my_result --dataset my_dataset -o transforms.json",
    )
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder made by 'rhizotwin reconstruct'")
    add_output(parser, "FILE", "what to write; its suffix says in which form")
    parser.add_argument("--dataset", type=Path, metavar="DATASET", help="the dataset that the result was made from; cameras need its lens")
    parser.add_argument("--roots", choices=("order", "diameter"), help="write the roots as tubes in colours of this, for a mesh")


def _add_plan(commands: Commands) -> None:
    parser = add_command(
        commands,
        "plan",
        "try capture plans on the twin before building or scanning",
        description="What a lab asks before it builds: how many views, odd or even, how many rings at which heights, how many pixels?\n"
        "Simulate, reconstruct and score a scene with every combination of the given numbers of views, camera heights and picture\n"
        "sizes, and say what each reaches: a table, plan.csv, plan.json and a figure, plan.png, and the cheapest plan that is good\n"
        "enough. A stopped run is taken up by the same command, and one with more views or heights adds to it. On two cores a run\n"
        "takes one to two minutes for 40 pictures of 800x600 of a small plant, and up to five for a large one: begin with few views\n"
        "and small pictures.",
        epilog="examples:\n"
        "  a first look in a few minutes:\n"
        "    rhizotwin plan radish_day05a -o my_plan --views 10,20 --image-wh 400x300 --profile clean\n"
        "  odd or even, one ring or two (the second 10 mm above the rim, tilted 8 degrees down):\n"
        "    rhizotwin plan radish_day15a -o my_plan --views 20,21,40,41 --heights=-42 --heights=-42,10:8\n"
        "  which heights, to stay within 3 % of the volume:\n"
        "    rhizotwin plan printed_8ml -o my_plan --views 41 --heights=-42 --heights=-100,-42 --heights=-42,10 --within 3\n"
        "  how many pixels, for a rig of your own with three draws of its errors:\n"
        "    rhizotwin plan my_scene.toml -o my_plan --views 40 --image-wh 800x600,1600x1200 --profile bench --seeds 3",
    )
    parser.add_argument("scene", metavar="SCENE", help="a scene file (TOML) or a name from 'rhizotwin scenes'")
    add_output(parser, "FOLDER", "folder for the table, the figure and the scores: new, or of an earlier plan")
    parser.add_argument(
        "--views", type=list_of(views), default=(20, 40, 41), metavar="N,N,...", help="views in a ring to try; default: 20,40,41"
    )
    parser.add_argument(
        "--heights",
        type=list_of(height),
        action="append",
        metavar="=MM[:DEG],...",
        help="heights of the camera over the canister's rim, one a ring, with the tilt below the horizon behind a colon; without one it "
        "looks where the scene's first ring looks; once for each set of rings to try; default: the scene's first ring, and it with a "
        "second one 52 mm higher",
    )
    parser.add_argument("--image-wh", type=list_of(image_wh), metavar="WxH,WxH,...", help="picture sizes to try; default: the scene's")
    parser.add_argument(
        "--profile", default="bench", metavar="NAME", help="what the rig gets wrong: clean, bench, harsh or a file; default: %(default)s"
    )
    parser.add_argument("--seeds", type=seeds, default=1, metavar="N", help="runs of each plan with other errors; default: %(default)s")
    parser.add_argument(
        "--within",
        type=percent,
        default=5.0,
        metavar="PERCENT",
        help="name the cheapest plan whose volume stays within this; default: %(default)s",
    )
    add_device(parser)


def _add_demo(commands: Commands) -> None:
    parser = add_command(
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
    add_device(parser)
