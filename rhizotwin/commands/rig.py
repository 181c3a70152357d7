"""Check and move the devices of a rig, and write a rig file.

Use these commands before the first scan and for troubleshooting. A rig file describes the devices: turntable, lights,
camera and arm. With the name twin instead of a rig file, the emulated rig in this program is used.

Examples
--------
rhizotwin rig example -o my_rig.toml
rhizotwin rig check my_rig.toml --scene my_scene.toml
rhizotwin rig jog my_rig.toml --scene my_scene.toml
rhizotwin rig align my_rig.toml --scene my_scene.toml
rhizotwin rig jog twin
"""

import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.steps import rigs
from rhizotwin.steps.arguments import OutputFile, SceneName, check_new_file, option, read_length_mm, with_metavar

DISTANCE_LIMITS_MM, HEIGHT_LIMITS_MM = (20.0, 10000.0), (-2000.0, 2000.0)


def check(
    rig: rigs.RigName,
    /,
    *,
    scene: SceneName | None = None,
    record: Annotated[Path | None, with_metavar("FILE")] = None,
    first_day: Annotated[Path | None, with_metavar("FOLDER")] = None,
    twin: rigs.TwinErrors = rigs.TwinErrors(),
) -> None:
    """Check each device of a rig.

    The command connects to each device, takes pictures with the lamps off and on, and prints one line per device. No
    device moves. The exit code is not 0 if a check fails.

    With --first-day, an interactive checklist for a new rig follows, during which devices move. It covers lamps,
    direction of each joint, arm in front of the canister, focus, orientation of the marker strip, uniformity of the
    light panel, direction of the turntable, and dimensions to measure with calipers. The findings are written to a
    folder that can be sent with a request for help.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes an example), or twin for the emulated rig.
    scene : str, optional
        Scene, which describes canister, marker strip and camera: a name listed by 'rhizotwin scenes', or a scene file
        (TOML); default: rig of Kliman's thesis (2022).
    record : Path, optional
        File to which all serial communication is appended (JSON lines).
    first_day : Path, optional
        New folder for the report of the interactive checklist, which follows the check.
    twin : TwinErrors
        Options of the emulated rig.

    Examples
    --------
    rhizotwin rig check my_rig.toml --scene my_scene.toml
    rhizotwin rig check my_rig.toml --scene my_scene.toml --first-day my_first_day
    rhizotwin rig check twin
    """
    from rhizotwin.rig.bench import check as look

    if first_day is not None and first_day.exists():
        raise UserError(f"{first_day} already exists; choose another folder for the report of --first-day")

    bench = rigs.open_bench(rig, scene, errors=twin)
    with ExitStack() as stack:
        recorder = rigs.recorder(record, stack)
        wrong = look(bench, say=print, folder=Path.cwd(), recorder=recorder)
        if first_day is not None:
            wrong = _walk(bench, first_day, recorder, wrong, stack)
    if wrong:
        raise UserError(f"{count(wrong, 'check')} of {bench.rig.name} failed, for the reasons printed above")


def _walk(bench: rigs.Bench, folder: Path, recorder: Any, wrong: int, stack: ExitStack) -> int:
    """Run the interactive checklist for a new rig, and return the number of failed checks."""
    from rhizotwin.rig.first_day import FirstDay

    devices = bench.open_devices(recorder, stack)
    try:
        findings = FirstDay(devices, bench.scene, ask=input, say=print, folder=folder).walk(wrong_devices=wrong)
    except EOFError:
        raise UserError("a question was not answered; run the command again and answer all questions") from None
    print(f"wrote {folder}/first_day.md and first_day.json; to get help, send this folder with your observations")
    return sum(one.verdict == "wrong" for one in findings)


def jog(
    rig: rigs.RigName,
    /,
    *,
    scene: SceneName | None = None,
    record: Annotated[Path | None, with_metavar("FILE")] = None,
    twin: rigs.TwinErrors = rigs.TwinErrors(),
) -> None:
    """Move the devices of a rig by typed commands.

    Type help for the list of commands. Each movement of the arm is checked for collisions before it starts. On exit,
    the lamps are switched off and the arm is parked and unpowered. Commands can also be read from a pipe; in this case
    the program ends at the first error.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes an example), or twin for the emulated rig.
    scene : str, optional
        Scene, which describes canister, marker strip and camera: a name listed by 'rhizotwin scenes', or a scene file
        (TOML); default: rig of Kliman's thesis (2022).
    record : Path, optional
        File to which all serial communication is appended (JSON lines).
    twin : TwinErrors
        Options of the emulated rig.

    Examples
    --------
    rhizotwin rig jog my_rig.toml --scene my_scene.toml
    rhizotwin rig jog twin
    """
    bench = rigs.open_bench(rig, scene, errors=twin)
    typed = sys.stdin.isatty()
    if typed:
        print("type help for the list of commands, quit to exit")
    _jog(bench, _typed_lines() if typed else sys.stdin, record=record, stop_at_mistake=not typed)


def align(
    rig: rigs.RigName,
    /,
    *,
    scene: SceneName | None = None,
    distance_mm: Annotated[float | None, option(lambda text: read_length_mm(text, DISTANCE_LIMITS_MM), "MM")] = None,
    height_mm: Annotated[float | None, option(lambda text: read_length_mm(text, HEIGHT_LIMITS_MM), "MM")] = None,
    record: Annotated[Path | None, with_metavar("FILE")] = None,
    twin: rigs.TwinErrors = rigs.TwinErrors(),
) -> None:
    """Align the camera with the canister: level, upright, and aimed at the axis.

    The arm moves the camera in front of the canister. The camera pose is then estimated from the markers in a picture
    and the joints are corrected, repeatedly as long as the alignment improves. The remaining error is printed, and can
    be up to half a step of the base servo. If the alignment does not improve, the command fails. On exit, the lamps are
    switched off and the arm is parked; to leave the arm in position, use the command align of 'rhizotwin rig jog'.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes an example), or twin for the emulated rig.
    scene : str, optional
        Scene, which describes canister, marker strip and camera: a name listed by 'rhizotwin scenes', or a scene file
        (TOML); default: rig of Kliman's thesis (2022).
    distance_mm : float, optional
        Distance of the camera from the canister's axis in mm; default: first camera position of the scene.
    height_mm : float, optional
        Height of the camera above the canister's rim in mm, negative below it; default: first camera position of the
        scene.
    record : Path, optional
        File to which all serial communication is appended (JSON lines).
    twin : TwinErrors
        Options of the emulated rig.

    Examples
    --------
    rhizotwin rig align my_rig.toml --scene my_scene.toml
    rhizotwin rig align twin --distance-mm 400 --height-mm=-42
    """
    bench = rigs.open_bench(rig, scene, errors=twin)
    ring = bench.scene.plan.rings[0]
    where = [ring.distance_mm if distance_mm is None else distance_mm, ring.height_mm if height_mm is None else height_mm]
    _jog(bench, ["lights 1 1", f"align {where[0]:.9g} {where[1]:.9g}"], record=record, stop_at_mistake=True)


def _jog(bench: rigs.Bench, lines: Iterable[str], *, record: Path | None, stop_at_mistake: bool) -> None:
    """Open the devices of a rig, and execute one command per line with `rig.jog`."""
    from rhizotwin.rig.jog import Jog

    with ExitStack() as stack:
        devices = bench.open_devices(rigs.recorder(record, stack), stack)
        Jog(devices, bench.scene, say=print).run(lines, stop_at_mistake=stop_at_mistake)


def example(*, output: OutputFile) -> None:
    """Write a complete, commented rig file as a starting point.

    The file contains all keys with their defaults and explanations.

    Parameters
    ----------
    output : Path
        File to write (TOML); must not exist yet.

    Examples
    --------
    rhizotwin rig example -o my_rig.toml
    """
    from rhizotwin.rig.example import EXAMPLE

    check_new_file(output)
    write_text(output, EXAMPLE, new=True)
    print(f"wrote {output}; edit the file, then run: rhizotwin rig check {output}")


def _typed_lines() -> Iterator[str]:
    """Yield the lines typed on the terminal until the end of the input."""
    while True:
        try:
            yield input("rig> ")
        except EOFError:
            return
