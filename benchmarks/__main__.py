"""The benchmarks' command line."""

import argparse
import json
import platform
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks import cases, gate
from benchmarks.metric import Metric
from scenes import atomic
from scenes.errors import UserError

HERE = Path(__file__).resolve().parent


def say(text: str) -> None:
    """Write a line for the person who waits."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def about(given: argparse.Namespace) -> dict[str, Any]:
    """Return what the numbers were measured with."""
    packages = ("mitsuba", "drjit", "numpy", "scipy", "opencv-python-headless", "scikit-image", "trimesh", "manifold3d")
    versions = {}
    for package in packages:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "command": f"{given.what}{' --quick' if given.quick else ''}",
        "device": given.device,
        "python": platform.python_version(),
        **versions,
    }


def results_table(metrics: Sequence[Metric]) -> str:
    """Return the numbers as text, with what must be reached beside them."""
    width = max((len(metric.key) for metric in metrics), default=0)
    lines = [f"{'metric':<{width}}  {'value':>12} unit  target"]
    for metric in metrics:
        target = ""
        if metric.key in cases.TARGETS:
            limit, text = cases.TARGETS[metric.key]
            target = f"{text}: {'reached' if abs(metric.value) <= limit else 'NOT REACHED'}"
        lines.append(f"{metric.key:<{width}}  {metric.value:>12.5g} {metric.unit:<4}  {target}".rstrip())
    return "\n".join(lines)


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure how well and how fast the twin and the reconstruction do, beside the numbers that were committed.",
    )
    made.add_argument(
        "what",
        choices=["accuracy", "speed", "rig"],
        help="accuracy: render, reconstruct, score; speed: wall times and memory; rig: faults, kills, kinematics, lens, a scan of the twin",
    )
    made.add_argument("--quick", action="store_true", help="the small set that runs with every change (accuracy: under five minutes)")
    made.add_argument("--gate", action="store_true", help="end with code 1 where a number is worse than the baseline or missing")
    made.add_argument("--update-baseline", action="store_true", help="record this run as the baseline, to be committed")
    made.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    made.add_argument("--only", metavar="TEXT", help="only the accuracy cases whose name holds TEXT; not with --gate or --update-baseline")
    made.add_argument("--list", action="store_true", help="name the accuracy cases and end")
    made.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON (default: the cache folder)")
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code."""
    given = parser().parse_args(arguments)
    try:
        return _run(given)
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


def _run(given: argparse.Namespace) -> int:
    chosen = [case for case in cases.ladder(quick=given.quick) if given.only is None or given.only in case.name]
    if given.list:
        say("\n".join(case.name for case in chosen))
        return 0
    if given.only is not None and (given.gate or given.update_baseline):
        raise UserError("--only leaves numbers out, so it goes with neither --gate nor --update-baseline.")
    if not chosen:
        raise UserError(f"--only {given.only!r} fits no case; --list names them.")
    baseline_path = HERE / f"baseline_{given.what}{'_quick' if given.quick else ''}.json"
    # A missing baseline is known before an hour of measuring, not after it.
    baseline = gate.read_baseline(baseline_path) if given.gate and not given.update_baseline else None

    from benchmarks import accuracy, cache, rig, speed  # these import the renderer
    from rhizotwin import engine

    engine.start(given.device)
    measure = {
        "accuracy": lambda: accuracy.measure(chosen, say=say),
        "rig": lambda: rig.measure(quick=given.quick, say=say),
        "speed": lambda: speed.measure(quick=given.quick, device=given.device, say=say),
    }
    run = measure[given.what]()
    say("\n" + results_table(run.metrics))

    described = about(given)
    output = given.output or cache.folder() / "results" / f"{baseline_path.stem.removeprefix('baseline_')}.json"
    output.parent.mkdir(parents=True, exist_ok=True)
    values = {m.key: {"value": m.value if m.measured else None, "unit": m.unit} for m in run.metrics}
    stored = json.loads(json.dumps({"about": described, "metrics": values, "crashed": run.crashed, "details": run.details}, default=str))
    atomic.write_json(output, stored)
    say(f"\nevery number: {output}")

    if given.update_baseline:
        if run.crashed:
            raise UserError(f"{baseline_path} is left as it was: {next(iter(run.crashed))} crashed.")
        gate.write_baseline(baseline_path, run.metrics, about=described)
        say(f"recorded: {baseline_path}")
        return 0
    if baseline is not None:
        findings = gate.compare(run.metrics, baseline, crashed=run.crashed)
        say("\n" + gate.table(findings))
        return 0 if gate.passes(findings) else 1
    return 1 if run.crashed else 0


if __name__ == "__main__":
    sys.exit(main())
