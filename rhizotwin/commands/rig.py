"""Look at every device, move them by hand, write a rig file.

For a person on the bench, before the first scan and when something is wrong.

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

from rhizotwin import rigs
from rhizotwin.arguments import OutputFile, SceneName, millimetres, named, option
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.errors import UserError

DISTANCE_LIMITS_MM, HEIGHT_LIMITS_MM = (20.0, 10000.0), (-2000.0, 2000.0)


def check(
    rig: rigs.RigName,
    /,
    *,
    scene: SceneName | None = None,
    record: Annotated[Path | None, named("FILE")] = None,
    first_day: Annotated[Path | None, named("FOLDER")] = None,
    twin: rigs.TwinErrors = rigs.TwinErrors(),
) -> None:
    """Look at every device: one line each, what is well or what is wrong.

    Connect to every device and take pictures with the lamps off and on. Nothing moves. The exit code is not 0 when
    anything is wrong.

    With --first-day you are walked on through what only a person can see, and things move: lamps, each joint's
    direction, the arm before the canister, focus, a mirrored strip, the panel's evenness, the table's direction, and
    sizes by calipers. The findings are written to a folder, to be sent back.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes': canister, strip and camera; default: the rig of the thesis.
    record : Path, optional
        Append every byte on the wire to this file (JSON lines).
    first_day : Path, optional
        Walk on through the list of the first day, and write its report to this folder, which must be new.
    twin : TwinErrors
        What the emulated rig gets wrong.

    Examples
    --------
    rhizotwin rig check my_rig.toml --scene my_scene.toml
    rhizotwin rig check my_rig.toml --scene my_scene.toml --first-day my_first_day
    rhizotwin rig check twin
    """
    from rhizotwin.rig.bench import check as look

    if first_day is not None and first_day.exists():
        raise UserError(f"{first_day} exists already; choose another folder for the first day's report")

    bench = rigs.open_bench(rig, scene, errors=twin)
    with ExitStack() as stack:
        recorder = rigs.recorder(record, stack)
        wrong = look(
            bench.rig, bench.scene, clock=bench.clock, open_camera=bench.open_camera, say=print, folder=Path.cwd(), recorder=recorder
        )
        if first_day is not None:
            wrong = _walk(bench, first_day, recorder, wrong, stack)
    if wrong:
        raise UserError(f"{wrong} {'thing is' if wrong == 1 else 'things are'} wrong with {bench.rig.name}; see the lines above")


def _walk(bench: rigs.Bench, folder: Path, recorder: Any, wrong: int, stack: ExitStack) -> int:
    """Walk a person through the first day; return how many things are wrong."""
    from rhizotwin.rig.first_day import FirstDay

    devices = bench.open_devices(recorder, stack)
    findings = FirstDay(devices, bench.scene, ask=_answer, say=print, folder=folder).walk(wrong_devices=wrong)
    print(f"wrote {folder}/first_day.md and first_day.json; send the folder back with what you saw")
    return sum(one.verdict == "wrong" for one in findings)


def _answer(question: str) -> str:
    """Put a question to whoever types, or to a pipe."""
    try:
        return input(question)
    except EOFError:
        raise UserError("the question was not answered; run it again and answer") from None


def jog(
    rig: rigs.RigName,
    /,
    *,
    scene: SceneName | None = None,
    record: Annotated[Path | None, named("FILE")] = None,
    twin: rigs.TwinErrors = rigs.TwinErrors(),
) -> None:
    """Move every device by typed lines.

    Type help for the commands. The arm's ways are checked first, and unsafe ones refused. At the end the lights go off
    and the arm is parked and let go. Lines can come from a pipe as well; then the first mistake ends it.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes': canister, strip and camera; default: the rig of the thesis.
    record : Path, optional
        Append every byte on the wire to this file (JSON lines).
    twin : TwinErrors
        What the emulated rig gets wrong.

    Examples
    --------
    rhizotwin rig jog my_rig.toml --scene my_scene.toml
    rhizotwin rig jog twin
    """
    bench = rigs.open_bench(rig, scene, errors=twin)
    typed = sys.stdin.isatty()
    if typed:
        print("type help for the commands, quit to end")
    _jog(bench, _typed_lines() if typed else sys.stdin, record=record, stop_at_mistake=not typed)


def align(
    rig: rigs.RigName,
    /,
    *,
    scene: SceneName | None = None,
    distance_mm: Annotated[float | None, option(lambda text: millimetres(text, DISTANCE_LIMITS_MM), "MM")] = None,
    height_mm: Annotated[float | None, option(lambda text: millimetres(text, HEIGHT_LIMITS_MM), "MM")] = None,
    record: Annotated[Path | None, named("FILE")] = None,
    twin: rigs.TwinErrors = rigs.TwinErrors(),
) -> None:
    """Turn the camera to face the canister: level, upright, and through its axis.

    The camera goes before the canister, takes a picture, finds its pose from the marker strip, corrects the joints, and
    repeats while it gets better. What is left is printed: servos move by steps, so that up to half a step of the base
    remains. An arm that comes no nearer is an error. At the end the lights go off and the arm is parked; 'align' in
    'rhizotwin rig jog' leaves it where it is.

    Parameters
    ----------
    rig : str
        Rig file, or the word twin: emulated devices in this program.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes': canister, strip and camera; default: the rig of the thesis.
    distance_mm : float, optional
        Camera to the canister's axis; default: that of the scene's first ring.
    height_mm : float, optional
        z of the camera, 0 at the rim; default: that of the scene's first ring.
    record : Path, optional
        Append every byte on the wire to this file (JSON lines).
    twin : TwinErrors
        What the emulated rig gets wrong.

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
    """Open a rig's devices and carry out typed lines."""
    from rhizotwin.rig.jog import Jog

    with ExitStack() as stack:
        devices = bench.open_devices(rigs.recorder(record, stack), stack)
        Jog(devices, bench.scene, say=print).run(lines, stop_at_mistake=stop_at_mistake)


def example(*, output: OutputFile) -> None:
    """Write a complete rig file with comments, to be changed.

    It has every key, its default and what it means.

    Parameters
    ----------
    output : Path
        File to write (TOML); must not exist yet.

    Examples
    --------
    rhizotwin rig example -o my_rig.toml
    """
    from rhizotwin.rig.example import EXAMPLE

    if output.exists():
        raise UserError(f"{output} exists already; choose another name")
    write_text(output, EXAMPLE, new=True)
    print(f"wrote {output}; change it, then try: rhizotwin rig check {output}")


def _typed_lines() -> Iterator[str]:
    """Yield what a person types until the end of the input."""
    while True:
        try:
            yield input("rig> ")
        except EOFError:
            return
