"""The words of the command line for the rig: scanning, the twin alone, the bench, and a camera served to another computer."""

import argparse
from pathlib import Path

from rhizotwin.arguments import Commands, Parser, add_command, add_device, add_output, seed, whole

ANGLE_LIMITS_DEG = (-360.0, 360.0)
SPEED_LIMITS = (0.01, 1000.0)
DEFAULT_CAMERA_PORT = 8471
RIG_HELP = "rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program"
SEED_HELP = "twin only: of every error that is drawn; default: %(default)s"
PROFILE_HELP = "twin only: what it gets wrong: clean (nothing), bench (a good rig), harsh (a bad day), or a file; default: %(default)s"


def add(commands: Commands) -> None:
    """Add ``scan``, ``twin``, ``rig`` and ``camera`` to the command line."""
    _add_scan(commands)
    _add_twin(commands)
    _add_rig(commands)
    _add_served_camera(commands)


def _add_scan(commands: Commands) -> None:
    parser = add_command(
        commands,
        "scan",
        "take the pictures of a plan on a rig, or on its emulated twin",
        description="Look at every device, bring the camera to the rings of the plan, turn the table and take the pictures. Stopped\n"
        "half-way (Ctrl-C, a fault, a power cut), the same command with --resume takes what is missing. Whatever ends it, the\n"
        "lights go off and the arm is parked and let go.",
        epilog="examples:\n"
        "  rhizotwin scan --rig twin -o my_scan --fidelity sketch\n"
        "  rhizotwin scan --rig twin --scene radish_day15a --profile bench --seed 3 -o my_scan\n"
        "  rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan\n"
        "  rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --resume\n"
        "  rhizotwin scan --rig my_rig.toml --scene my_scene.toml --plan two_rings.toml -o my_scan --record my_scan.jsonl",
    )
    parser.add_argument("--rig", required=True, metavar="RIG|twin", help=RIG_HELP)
    parser.add_argument(
        "--scene",
        metavar="SCENE",
        help="a scene file, or a name from 'rhizotwin scenes': canister, strip, calibrated lens and plan; needed for a rig file; "
        "the twin's default: printed_8ml",
    )
    parser.add_argument(
        "--plan",
        metavar="PLAN",
        help="take the rings from here instead of the scene: a file with [[plan.rings]], or a scene's name",
    )
    add_output(parser, "DATASET", "folder to make the dataset in: new or empty; with --resume one that a stopped scan left")
    parser.add_argument("--resume", action="store_true", help="finish a stopped scan: what it took is kept and not taken again")
    parser.add_argument(
        "--table-angle",
        type=_angle_deg,
        metavar="DEG",
        help="the table's angle now, if the markers cannot be read at the start; 0: the strip's seam faces the camera",
    )
    parser.add_argument("--record", type=Path, metavar="FILE", help="keep every byte on the wire in this file (JSON lines); it grows")
    parser.add_argument("--profile", default="bench", metavar="clean|bench|harsh", help=PROFILE_HELP)
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help=SEED_HELP)
    _add_fidelity(parser, "render")
    add_device(parser)


def _add_twin(commands: Commands) -> None:
    parser = add_command(
        commands,
        "twin",
        "run the emulated rig alone, on ports that any serial program can open",
        description="Start the emulated turntable, lights and arm on pseudo-terminals, and print the ports. They speak the bytes of the\n"
        "real devices, in real time; the camera is served over HTTP. Faults can be typed while it runs. Ctrl-C ends it.",
        epilog="examples:\n"
        "  rhizotwin twin\n"
        "  rhizotwin twin --scene sphere_20mm --profile bench --seed 3 -o my_twin_rig.toml\n"
        "  rhizotwin rig check my_twin_rig.toml",
    )
    parser.add_argument(
        "--scene", default="printed_8ml", metavar="SCENE", help="a scene file, or a name from 'rhizotwin scenes'; default: %(default)s"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of every error that is drawn; default: %(default)s")
    parser.add_argument(
        "--profile", default="bench", metavar="clean|bench|harsh", help="what the rig gets wrong, or a file; default: %(default)s"
    )
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="X", help="how many times faster than real its time passes; default: %(default)s"
    )
    parser.add_argument(
        "--protocol", choices=("lx", "lsc"), default="lx", help="what the arm speaks: servo bus or controller board; default: %(default)s"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="RIG", help="write a rig file (TOML) with these ports; must not exist yet")
    _add_fidelity(parser, "sketch")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="FAULT",
        help="something that goes wrong, such as 'reset', or 'reply_late table amount=3 at_s=20'; may be given several times",
    )
    parser.add_argument("--camera-port", type=_port, default=0, metavar="N", help="of the camera's HTTP server; default: a free one")
    add_device(parser)


def _add_rig(commands: Commands) -> None:
    parser = add_command(
        commands,
        "rig",
        "help on the bench: look at every device, move them by hand, write a rig file",
        description="For a person on the bench, before the first scan and when something is wrong.",
        epilog="examples:\n"
        "  rhizotwin rig example -o my_rig.toml\n"
        "  rhizotwin rig check my_rig.toml --scene my_scene.toml\n"
        "  rhizotwin rig jog my_rig.toml --scene my_scene.toml\n"
        "  rhizotwin rig jog twin",
    )
    steps = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    check = add_command(
        steps,
        "check",
        "look at every device: one line each, what is well or what is wrong",
        description="Connect to every device and take pictures with the lamps off and on. Nothing moves. The exit code is not 0 when\n"
        "anything is wrong.",
        epilog="examples:\n  rhizotwin rig check my_rig.toml --scene my_scene.toml\n  rhizotwin rig check twin",
    )
    jog = add_command(
        steps,
        "jog",
        "move every device by typed lines",
        description="Type help for the commands. The arm's ways are checked first, and unsafe ones refused. At the end the lights go off\n"
        "and the arm is parked and let go. Lines can come from a pipe as well; then the first mistake ends it.",
        epilog="examples:\n  rhizotwin rig jog my_rig.toml --scene my_scene.toml\n  rhizotwin rig jog twin",
    )
    for step in (check, jog):
        step.add_argument("rig", metavar="RIG|twin", help=RIG_HELP)
        step.add_argument(
            "--scene",
            metavar="SCENE",
            help="a scene file, or a name from 'rhizotwin scenes': canister, strip and camera; default: the rig of the thesis",
        )
        step.add_argument("--record", type=Path, metavar="FILE", help="keep every byte on the wire in this file (JSON lines); it grows")
        step.add_argument("--profile", default="bench", metavar="clean|bench|harsh", help=PROFILE_HELP)
        step.add_argument("--seed", type=seed, default=0, metavar="S", help=SEED_HELP)
    example = add_command(
        steps,
        "example",
        "write a complete rig file with comments, to be changed",
        description="Write a rig file with every key, its default and what it means.",
        epilog="examples:\n  rhizotwin rig example -o my_rig.toml",
    )
    add_output(example, "FILE", "file to write (TOML); must not exist yet")


def _add_served_camera(commands: Commands) -> None:
    parser = add_command(
        commands,
        "camera",
        "serve this computer's camera to another one",
        description='Serve the camera of a rig file over HTTP, for a computer whose rig file has kind = "http" in its [camera] section.\n'
        "Only this computer can connect unless --host says otherwise; there is no password. Ctrl-C ends it.",
        epilog="examples:\n  rhizotwin camera my_rig.toml\n  rhizotwin camera my_rig.toml --host 0.0.0.0 --port 8471",
    )
    parser.add_argument("rig", metavar="RIG", help="rig file (TOML) with the camera of this computer")
    parser.add_argument("--scene", metavar="SCENE", help="whose camera says the size of the pictures until a scan asks; default: 800x600")
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on; 0.0.0.0: all; default: %(default)s")
    parser.add_argument("--port", type=_port, default=DEFAULT_CAMERA_PORT, metavar="N", help="default: %(default)s")


def _add_fidelity(parser: Parser, default: str) -> None:
    parser.add_argument(
        "--fidelity",
        choices=("render", "sketch"),
        default=default,
        help="of the twin's pictures: render: as 'simulate' makes them; sketch: strip and panel only, at once; default: %(default)s",
    )


def _angle_deg(text: str) -> float:
    return _number(text, ANGLE_LIMITS_DEG, "deg")


def _speed(text: str) -> float:
    return _number(text, SPEED_LIMITS, "times real time")


def _port(text: str) -> int:
    return whole(text, 1, 65535, "give 1 to 65535")


def _number(text: str, limits: tuple[float, float], unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    low, high = limits
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is out of range, give {low:g} to {high:g} {unit}")
    return value
