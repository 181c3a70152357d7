"""The benchmarks' command line."""

import argparse
import json
import platform
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks import cases, gate, mixtures, scatter
from benchmarks.metric import Metric
from benchmarks.run import Run
from benchmarks.targets import TARGETS
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

HERE = Path(__file__).resolve().parent


def say(text: str) -> None:
    """Write a line for the person who waits."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def about(given: argparse.Namespace) -> dict[str, Any]:
    """Return what the numbers were measured with."""
    from rhizotwin import sources

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
        "reconstruction": sources.digest(("rhizotwin.recon.reconstruct",))[:12],
        "python": platform.python_version(),
        **versions,
    }


def results_table(metrics: Sequence[Metric]) -> str:
    """Return the numbers as text, with what must be reached beside them."""
    width = max((len(metric.key) for metric in metrics), default=0)
    lines = [f"{'metric':<{width}}  {'value':>12} unit  target"]
    for metric in metrics:
        target = ""
        if metric.key in TARGETS:
            wanted = TARGETS[metric.key]
            target = f"{wanted.text}: {'reached' if wanted.reached(metric.value) else 'NOT REACHED'}"
        lines.append(f"{metric.key:<{width}}  {metric.value:>12.5g} {metric.unit:<4}  {target}".rstrip())
    return "\n".join(lines)


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure how well and how fast the twin and the reconstruction do, beside the numbers that were committed.",
    )
    what = made.add_subparsers(dest="what", metavar="WHAT", required=True)
    texts = {
        "accuracy": "the ladder: render (or take from the cache), reconstruct, score; a stopped run goes on where it stopped",
        "speed": "wall times and memory",
        "rig": "faults, kills, kinematics, lens, a scan of the twin",
    }
    for name, text in texts.items():
        one = what.add_parser(name, help=text, description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
        one.add_argument("--quick", action="store_true", help="the small set that runs with every change (accuracy: under five minutes)")
        one.add_argument("--gate", action="store_true", help="end with code 1 where a number is worse than the baseline or missing")
        one.add_argument("--update-baseline", action="store_true", help="record this run as the baseline, to be committed")
        one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
        one.add_argument(
            "-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON (default: the cache folder)"
        )
        if name == "accuracy":
            _add_selection(one)
    _add_scatter(what.add_parser("scatter", help=_SCATTER, description=_SCATTER))
    _add_scaling(what.add_parser("scaling", help=_SCALING, description=_SCALING))
    compared = what.add_parser("compare", help="two runs of the ladder on the same pictures, or the speed of this code against a commit's")
    compared.add_argument("before", type=Path, nargs="?", metavar="A.json", help="what `accuracy -o A.json` wrote before the change")
    compared.add_argument(
        "after", type=Path, nargs="?", metavar="B.json", help="the same after it; cases that only one of them has are left out"
    )
    compared.add_argument("--method", choices=cases.METHODS, default="coverage", help="default: %(default)s")
    compared.add_argument("--against", metavar="COMMIT", help="check this commit out beside and alternate runs: processor time and memory")
    compared.add_argument("--jobs", type=_words, metavar="NAME,...", help="only these of --against's jobs (a wrong name lists them)")
    compared.add_argument("--repeats", type=int, default=3, help="pairs of runs a job (default: %(default)s)")
    compared.add_argument("--quick", action="store_true", help="small jobs, under two minutes a pair")
    compared.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    compared.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the ratios as JSON, too")
    mixed = what.add_parser("mixtures", help=_MIXTURES, description=_MIXTURES)
    mixed.add_argument("--count", type=int, default=mixtures.COUNT, metavar="N", help="default: %(default)s")
    mixed.add_argument("--first", type=int, default=0, metavar="K", help="begin with this one (default: %(default)s)")
    mixed.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    mixed.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON, and a table beside it (.md)")
    _add_damages(what.add_parser("damages", help=_DAMAGES, description=_DAMAGES))
    adopted = what.add_parser("adopt", help="take rendered datasets into the cache, if and only if they are what it would render")
    adopted.add_argument(
        "folders", type=Path, nargs="+", metavar="DATASET", help="folders that `rhizotwin simulate` or an older cache made"
    )
    adopted.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    return made


_SCALING = "how processor time and memory grow with views, pixels, length of roots and finer voxels, one at a time"


def _add_scaling(one: argparse.ArgumentParser) -> None:
    one.add_argument("--axes", type=_words, metavar="NAME,...", help="only these (a wrong name lists them)")
    one.add_argument("--quick", action="store_true", help="small pictures, two points an axis")
    one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    one.add_argument("-o", "--output", type=Path, metavar="FILE", help="write every point as JSON, too")


_MIXTURES = "small drawn plants with drawn troubles: how often the interval of trusted scans holds; a stopped run goes on where it stopped"
_DAMAGES = "one clean scan, spoilt as laboratories spoil theirs: is a wrong volume ever called trusted?"
_SCATTER = "how far every number moves when only the last bits of the pictures do: the gate's tolerances; a stopped run goes on"


def _add_damages(one: argparse.ArgumentParser) -> None:
    one.add_argument("--names", type=_words, metavar="NAME,...", help="only these (a wrong name lists them)")
    one.add_argument("--scene", default="printed_8ml", help="whose clean scan of the quick ladder (default: %(default)s)")
    one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    one.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON, and a table beside it (.md)")


def _add_scatter(one: argparse.ArgumentParser) -> None:
    one.add_argument("--quick", action="store_true", required=True, help="of the small set (the full one would take weeks)")
    one.add_argument("--scenes", type=_words, metavar="PATTERN,...", help="only these scenes of it; the others' numbers stay as they are")
    _add_profiles_and_methods(one)
    one.add_argument("--runs", type=int, default=scatter.RUNS, metavar="N", help="default: %(default)s")
    one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")


def _add_selection(one: argparse.ArgumentParser) -> None:
    one.epilog = (
        "a part of the ladder, for example (it gives part of the table, and goes with --gate only where it is part of --quick):\n"
        "  python -m benchmarks accuracy --scenes 'radish_day0*,fallen_plant' --profiles clean,bench --methods coverage -o before.json\n"
        "two runs are compared case by case:\n  python -m benchmarks compare before.json after.json"
    )
    one.add_argument(
        "--scenes", type=_words, metavar="PATTERN,...", help="only the ladder's scenes whose name fits, such as 'radish_day0*'"
    )
    _add_profiles_and_methods(one)
    one.add_argument(
        "--seeds",
        type=_seeds,
        metavar="S,...",
        help="seeds of disturbances and plants, or a named set: "
        + ", ".join(f"{name} ({', '.join(map(str, seeds))})" for name, seeds in cases.SEED_SETS.items())
        + "; default: first. The second set is for the end: never look at it while something is developed",
    )
    one.add_argument(
        "--change",
        type=_change,
        default="none",
        metavar="KIND:SEED",
        help="rounded:S, pictures as another machine may have rounded them; lossy:S, one in twenty mirrored; S: 1, 2, ...",
    )
    one.add_argument("--list", action="store_true", help="name the cases and end")
    one.add_argument("--afresh", action="store_true", help="measure again what an earlier run with the same code measured")


def _add_profiles_and_methods(one: argparse.ArgumentParser) -> None:
    one.add_argument("--profiles", type=_words_of(cases.PROFILES), metavar="NAME,...", help=f"only these of {', '.join(cases.PROFILES)}")
    one.add_argument("--methods", type=_words_of(cases.METHODS), metavar="NAME,...", help=f"only these of {', '.join(cases.METHODS)}")


def _change(text: str) -> str:
    kind, _, seed = text.partition(":")
    if text != "none" and (kind not in ("rounded", "lossy") or not seed.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is none of rounded:SEED, lossy:SEED, none")
    return text


def _words(text: str) -> tuple[str, ...]:
    words = tuple(word for word in text.split(",") if word)
    if not words:
        raise argparse.ArgumentTypeError("is empty")
    return words


def _words_of(allowed: Sequence[str]) -> Callable[[str], tuple[str, ...]]:
    def words(text: str) -> tuple[str, ...]:
        found = _words(text)
        unknown = [word for word in found if word not in allowed]
        if unknown:
            raise argparse.ArgumentTypeError(f"{unknown[0]!r} is none of {', '.join(allowed)}")
        return found

    return words


def _seeds(text: str) -> tuple[int, ...]:
    if text in cases.SEED_SETS:
        return cases.SEED_SETS[text]
    try:
        found = tuple(dict.fromkeys(int(word) for word in _words(text)))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither whole numbers nor one of {', '.join(cases.SEED_SETS)}") from None
    if min(found) < 0:
        raise argparse.ArgumentTypeError(f"{min(found)} is negative")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks; returns the exit code."""
    given = parser().parse_args(arguments)
    try:
        if given.what == "compare":
            return _compare(given)
        if given.what == "scatter":
            return _scatter(given)
        if given.what == "scaling":
            return _scaling(given)
        if given.what == "mixtures":
            return _mixtures(given)
        if given.what == "damages":
            return _damages(given)
        return _adopt(given) if given.what == "adopt" else _run(given)
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


def _mixtures(given: argparse.Namespace) -> int:
    if given.count < 1 or given.first < 0:
        raise UserError("--count must be 1 or more, and --first 0 or more")
    records = mixtures.measure(range(given.first, given.first + given.count), device=given.device, say=say)
    say("\n" + mixtures.table(records))
    output = given.output or _results() / "mixtures.json"
    stored = {"about": about(argparse.Namespace(what="mixtures", quick=False, device=given.device)), "records": records}
    atomic.write_json(output, stored | {"summary": mixtures.summary(records)})
    atomic.write_text(output.with_suffix(".md"), mixtures.table(records))
    say(f"every number: {output}")
    return 1 if any("crashed" in record for record in records) else 0


def _damages(given: argparse.Namespace) -> int:
    """Try every damage; 1 where a wrong volume is called trusted, or something crashed."""
    from benchmarks import damages
    from rhizotwin import engine

    engine.start(given.device)
    records = damages.measure(given.names, scene=given.scene, say=say)
    say("\n" + damages.table(records))
    output = given.output or _results() / "damages.json"
    atomic.write_json(output, {"about": about(argparse.Namespace(what="damages", quick=False, device=given.device)), "records": records})
    atomic.write_text(output.with_suffix(".md"), damages.table(records))
    say(f"every number: {output}")
    return 1 if any(damages.fails(record) for record in records) else 0


def _compare(given: argparse.Namespace) -> int:
    from benchmarks import paired

    if given.against is not None:
        return _against(given)
    if given.before is None or given.after is None:
        raise UserError("give two runs (A.json B.json), or --against COMMIT")
    say(paired.compare(paired.read_records(given.before), paired.read_records(given.after), method=given.method))
    return 0


def _scatter(given: argparse.Namespace) -> int:
    """Measure the scatter and record it."""
    selection = {name: getattr(given, name) for name in ("scenes", "profiles", "methods") if getattr(given, name) is not None}
    values, crashed = scatter.measure(cases.quick(**selection), runs=given.runs, device=given.device, say=say)
    if crashed:
        raise UserError(f"{next(iter(crashed))} crashed, so that the scatter is left as it was.")
    say("\n" + scatter.table(values))
    scatter.write(_scatter_path(), values, about=about(given))
    say(f"recorded: {_scatter_path()}")
    return 0


def _scaling(given: argparse.Namespace) -> int:
    from benchmarks import scaling

    found = scaling.measure(given.axes, quick=given.quick, device=given.device, say=say)
    say("\n" + scaling.table(found))
    if given.output is not None:
        atomic.write_json(given.output, scaling.as_json(found))
    return 0


def _scatter_path() -> Path:
    return HERE / "scatter_accuracy_quick.json"


def _against(given: argparse.Namespace) -> int:
    from benchmarks import against

    jobs: tuple[against.Job, ...] = against.QUICK if given.quick else against.JOBS
    if given.jobs is not None:
        unknown = [name for name in given.jobs if name not in {job.name for job in jobs}]
        if unknown:
            raise UserError(f"--jobs {unknown[0]} is none of {', '.join(job.name for job in jobs)}")
        jobs = tuple(job for job in jobs if job.name in given.jobs)
    if given.repeats < 1:
        raise UserError(f"--repeats {given.repeats}: give at least one pair")
    ratios = against.compare(given.against, jobs=jobs, repeats=given.repeats, device=given.device, say=say)
    say("\n" + against.table(ratios))
    if given.output is not None:
        atomic.write_json(given.output, against.as_json(given.against, ratios))
    return 0


def _adopt(given: argparse.Namespace) -> int:
    """Adopt each folder; those that do not fit are named and the rest go on."""
    from benchmarks.adopt import adopt
    from rhizotwin import engine

    engine.start(given.device)
    refused = 0
    for number, folder in enumerate(given.folders, start=1):
        try:
            say(f"[{number}/{len(given.folders)}] {folder} -> {adopt(folder)}")
        except UserError as error:
            refused += 1
            say(f"[{number}/{len(given.folders)}] REFUSED: {error}")
    return 1 if refused else 0


def _chosen(given: argparse.Namespace) -> tuple[list[cases.Case], bool]:
    """Return the cases to run, and whether they are a part that can neither gate nor become the baseline."""
    selection = {name: getattr(given, name) for name in ("scenes", "profiles", "seeds", "methods") if getattr(given, name) is not None}
    if given.quick and "seeds" in selection:
        raise UserError("the quick set has no seeds; leave out --seeds or --quick.")
    return (cases.quick(**selection) if given.quick else cases.ladder(**selection)), bool(selection)


def _run(given: argparse.Namespace) -> int:
    chosen: list[cases.Case] = []
    if given.what == "accuracy":
        chosen, is_part = _chosen(given)
        if given.list:
            say("\n".join(case.name for case in chosen))
            return 0
        if given.change != "none" and given.update_baseline:
            raise UserError("changed pictures cannot become the baseline; leave out --change or --update-baseline.")
        if is_part and (given.update_baseline or (given.gate and not given.quick)):
            what = "cannot become the baseline" if given.update_baseline else "goes with --gate only with --quick"
            raise UserError(f"a part of the ladder leaves numbers out, so it {what}.")
    baseline_path = HERE / f"baseline_{given.what}{'_quick' if given.quick else ''}.json"
    # A missing baseline is known before an hour of measuring, not after it.
    baseline = gate.read_baseline(baseline_path) if given.gate and not given.update_baseline else None
    is_scattered = given.what == "accuracy" and given.quick and baseline is not None
    rounding = scatter.read(_scatter_path()) if is_scattered else None
    run = _measured(given, chosen)
    is_long = given.what == "accuracy" and not given.quick
    shown = [metric for metric in run.metrics if not is_long or metric.key in TARGETS or metric.key.startswith(("ladder/", "projection/"))]
    say("\n" + results_table(shown))

    described = about(given)
    change = getattr(given, "change", "none")
    suffix = "" if change == "none" else "_" + change.replace(":", "_")
    output = given.output or _results() / f"{baseline_path.stem.removeprefix('baseline_')}{suffix}.json"
    values = {m.key: {"value": m.value if m.measured else None, "unit": m.unit} for m in run.metrics}
    stored = json.loads(json.dumps({"about": described, "metrics": values, "crashed": run.crashed, "details": run.details}, default=str))
    atomic.write_json(output, stored)
    say(f"\nevery number: {output}")
    if is_long:
        _write_ladder(run, output)

    if given.update_baseline:
        if run.crashed:
            raise UserError(f"{baseline_path} is left as it was: {next(iter(run.crashed))} crashed.")
        gate.write_baseline(baseline_path, run.metrics, about=described)
        say(f"recorded: {baseline_path}")
        return 0
    if baseline is not None:
        if rounding is not None:
            baseline = baseline.without({case.name for case in cases.quick()} - {case.name for case in chosen})
        findings = gate.compare(run.metrics, baseline, crashed=run.crashed, scatter=rounding)
        say("\n" + gate.table(findings))
        unmeasured = 0 if rounding is None else sum(m.key not in rounding.ranges for m in scatter.of_cases(run.metrics, chosen))
        if unmeasured:
            say(f"the tolerance of {unmeasured} of them is an estimate; `python -m benchmarks scatter --quick` measures it")
        return 0 if gate.passes(findings) else 1
    return 1 if run.crashed else 0


def _results() -> Path:
    from benchmarks import cache

    return cache.folder() / "results"


def _measured(given: argparse.Namespace, chosen: Sequence[cases.Case]) -> Run:
    if given.what == "accuracy":
        from benchmarks import accuracy, table

        run = accuracy.measure(chosen, device=given.device, say=say, afresh=given.afresh, change=given.change)
        if not given.quick:
            run.metrics += [line.metric() for line in table.lines(run.details.values())]
        return run
    if given.what == "speed":
        from benchmarks import speed

        return speed.measure(quick=given.quick, device=given.device, say=say)
    from benchmarks import rig
    from rhizotwin import engine

    engine.start(given.device)
    return rig.measure(quick=given.quick, say=say)


def _write_ladder(run: Run, output: Path) -> None:
    """Write the ladder's table and figure beside the numbers, and show the groups."""
    from benchmarks import figure, table

    records = list(run.details.values())
    text = table.markdown(table.lines(records), records)
    say("\n" + text.partition("\n\n")[0])
    written = [output.with_suffix(".md"), output.with_suffix(".csv")]
    atomic.write_text(written[0], text)
    atomic.write_text(written[1], table.comma_separated(records))
    if figure.draw(records, output.with_suffix(".png")):
        written.append(output.with_suffix(".png"))
    say("\ntable and figure: " + ", ".join(str(path) for path in written))


if __name__ == "__main__":
    sys.exit(main())
