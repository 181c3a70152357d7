"""Arguments of the benchmarks' command line."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import cases, intervals, scatter, tree_faults

CHANGES = ("rounded", "dithered", "shuffled", "lossy")
"""Changes of the pictures (`benchmarks.perturb`, which is imported by the commands that need it)."""


FROZEN_RUNS = 8
"""Runs with changed pictures of each frozen case."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure accuracy and speed of simulation and reconstruction, and compare them with committed baselines.",
    )
    what = made.add_subparsers(dest="what", metavar="WHAT", required=True)
    texts = {
        "accuracy": "accuracy ladder: render (or load from the cache), reconstruct, score; a stopped run is resumed",
        "speed": "wall times and memory",
        "rig": "faults, kills, kinematics, lens, a scan of the twin",
    }
    for name, text in texts.items():
        one = what.add_parser(name, help=text, description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
        one.add_argument("--quick", action="store_true", help="the small set, run for every change (accuracy: under five minutes)")
        one.add_argument("--gate", action="store_true", help="exit with code 1 if a number is worse than the baseline or missing")
        one.add_argument("--update-baseline", action="store_true", help="record this run as the baseline, to be committed")
        _add_device(one)
        _add_output(one)
        if name == "accuracy":
            _add_selection(one)
        if name == "speed":
            _add_ratios(one)
    _add_scatter(what.add_parser("scatter", help=_SCATTER, description=_SCATTER))
    compared = what.add_parser("compare", help="compare two runs of the ladder on the same pictures")
    compared.add_argument("before", type=Path, metavar="A.json", help="output of `accuracy -o A.json` before the change")
    compared.add_argument("after", type=Path, metavar="B.json", help="output after the change; cases in only one of them are ignored")
    compared.add_argument("--method", choices=cases.METHODS, default="coverage", help="default: %(default)s")
    _add_intervals(what.add_parser("intervals", help=_INTERVALS, description=_INTERVALS))
    _add_damages(what.add_parser("damages", help=_DAMAGES, description=_DAMAGES))
    _add_thesis(what.add_parser("thesis", help=_THESIS, description=_THESIS))
    _add_growth(what.add_parser("growth", help=_GROWTH, description=_GROWTH))
    _add_frozen(what)
    printed = what.add_parser("fingerprints", help="write the fingerprints with which `rhizotwin bench make` compares a rendered benchmark")
    printed.add_argument("name", metavar="NAME", help="name of the benchmark, such as quick-1")
    printed.add_argument("folder", type=Path, metavar="FOLDER", help="folder in which `rhizotwin bench make` rendered it")
    return made


def _add_device(one: argparse.ArgumentParser) -> None:
    one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")


def _add_output(
    one: argparse.ArgumentParser, metavar: str = "FILE", text: str = "where to write every number as JSON (default: the cache folder)"
) -> None:
    one.add_argument("-o", "--output", type=Path, metavar=metavar, help=text)


_FREEZE = "twelve cases with pictures, intermediate values and scores in one folder, to compare changes of the reconstruction with"
_AGAINST = "reconstruct frozen pictures with the present code; the change of every kind of intermediate values, and of the scores"


def _add_frozen(what: Any) -> None:
    freeze = what.add_parser("freeze", help=_FREEZE, description=f"{_FREEZE}; a stopped run is resumed")
    against = what.add_parser("against", help=_AGAINST, description=_AGAINST)
    against.add_argument("frozen", type=Path, metavar="FROZEN", help="folder written by `freeze`")
    _add_output(freeze, "FOLDER", "new folder (default: in the cache folder)")
    _add_output(against, text="where to write every number as JSON (default: only the table)")
    for one in (freeze, against):
        one.add_argument("--cases", type=_words, metavar="NAME,...", help="only these cases (a wrong name lists them)")
        _add_device(one)


_THESIS = (
    "one page that compares the thesis's table 4.1 and figures 3.6 to 3.10, 4.1 and 5.3 with its re-implemented method and ours, "
    "and the effect of its assumptions; a stopped run is resumed, and measurements of the ladder are reused"
)


def _add_thesis(one: argparse.ArgumentParser) -> None:
    one.add_argument(
        "--profile", choices=cases.PROFILES, default="clean", help="disturbance profile of the radishes' pictures (default: %(default)s)"
    )
    one.add_argument("--committed", action="store_true", help="use the radishes' volumes of the ladder's committed baseline")
    one.add_argument("--kept", action="store_true", help="use earlier measurements only; missing values are shown as dashes")
    _add_device(one)
    _add_output(one, "FILE.md", "page; figures are written beside it (default: the cache folder)")


_GROWTH = (
    "one plant reconstructed on six days: identification and elongation of its roots; "
    "detection of a treatment effect and coverage of dose-response intervals, from true lengths with a scan's error; days are reused"
)


def _add_growth(one: argparse.ArgumentParser) -> None:
    one.add_argument(
        "--profile", choices=cases.PROFILES, default="bench", help="disturbance profile of the plant's pictures (default: %(default)s)"
    )
    one.add_argument("--sets", type=int, default=20, metavar="N", help="number of sets of plants (default: %(default)s)")
    one.add_argument("--no-pictures", action="store_true", help="only treatments and doses, without rendering and reconstruction")
    _add_device(one)
    _add_output(one)


def _add_ratios(one: argparse.ArgumentParser) -> None:
    one.add_argument("--against", metavar="COMMIT", help="check out this commit and alternate runs: processor time and memory")
    one.add_argument("--jobs", type=_words, metavar="NAME,...", help="only these jobs of --against (a wrong name lists them)")
    one.add_argument("--repeats", type=int, default=3, help="pairs of runs per job of --against (default: %(default)s)")
    one.add_argument(
        "--scaling",
        action="store_true",
        help="growth of processor time and memory with views, pixels, length of roots and finer voxels, one at a time; a figure beside -o",
    )
    one.add_argument("--axes", type=_words, metavar="NAME,...", help="only these axes of --scaling (a wrong name lists them)")


_INTERVALS = (
    "small random scans of random subjects: coverage of the 90 %% intervals, and the factors that calibrate them; a stopped run is resumed"
)
_DAMAGES = "one clean scan with typical errors of laboratories: is a wrong volume ever trusted?"
_SCATTER = (
    "variation of all numbers under rounding of the pictures: tolerances of the gate, and how often it opens; a stopped run is resumed"
)


def _add_intervals(one: argparse.ArgumentParser) -> None:
    one.add_argument("--count", type=int, default=intervals.COUNT, metavar="N", help="number of scans (default: %(default)s)")
    one.add_argument("--first", type=int, default=0, metavar="K", help="number of the first scan (default: %(default)s)")
    one.add_argument("--processes", type=int, default=1, metavar="P", help="number of scans at the same time (default: %(default)s)")
    _add_device(one)
    one.add_argument(
        "--table",
        type=Path,
        metavar="FILE.csv",
        help="evaluate this table of an earlier run, such as benchmarks/intervals.csv, without new scans",
    )
    one.add_argument("--calibrate", action="store_true", help="record the factors in recon/uncertainty, and the table beside this command")
    _add_output(one, "FILE.csv", "table of all scans; a page and a figure are written beside it (.md, .png)")


def _add_damages(one: argparse.ArgumentParser) -> None:
    one.add_argument("--names", type=_words, metavar="NAME,...", help="only these damages (a wrong name lists them)")
    one.add_argument("--scene", default="printed_8ml", help="scene of the quick ladder whose clean scan is used (default: %(default)s)")
    _add_device(one)
    _add_output(one, text="where to write every number as JSON, and a table beside it (.md)")


def _add_scatter(one: argparse.ArgumentParser) -> None:
    which = one.add_mutually_exclusive_group(required=True)
    which.add_argument("--quick", action="store_true", help="the small set, whose scatter is the tolerance of the gate")
    which.add_argument("--nightly", action="store_true", help="the dense root systems, in the same way")
    which.add_argument(
        "--frozen",
        type=_words,
        metavar="NAME,...",
        help="frozen cases under rounding, noise of half a grey level and another order of views",
    )
    one.add_argument("--scenes", type=_words, metavar="PATTERN,...", help="only these scenes; numbers of the others are not changed")
    _add_profiles_and_methods(one)
    one.add_argument(
        "--runs", type=int, metavar="N", help=f"runs with changed pictures (default: {scatter.RUNS}, of frozen cases {FROZEN_RUNS})"
    )
    one.add_argument(
        "--change",
        choices=(scatter.ROUNDED, "lossy"),
        default=scatter.ROUNDED,
        help="lossy: one picture in twenty mirrored; reports how often the gate shuts, without recording (default: %(default)s)",
    )
    _add_device(one)


def _add_selection(one: argparse.ArgumentParser) -> None:
    one.epilog = (
        "a part of the ladder, for example (it gives a part of the table; --update-baseline renews its cases):\n"
        "  python -m benchmarks accuracy --scenes 'radish_day0*,fallen_plant' --profiles clean,bench --methods coverage -o before.json\n"
        "two runs are compared case by case:\n  python -m benchmarks compare before.json after.json"
    )
    one.add_argument(
        "--scenes", type=_words, metavar="PATTERN,...", help="only scenes of the ladder whose name matches, such as 'radish_day0*'"
    )
    _add_profiles_and_methods(one)
    one.add_argument("--rings", type=_rings, metavar="N,...", help="only plants in this number of rings, 1 or 2")
    one.add_argument("--nightly", action="store_true", help="dense root systems in one ring: " + ", ".join(cases.NIGHTLY))
    one.add_argument(
        "--seeds",
        type=_seeds,
        metavar="S,...",
        help="seeds of disturbances and plants, or a named set: "
        + ", ".join(f"{name} ({', '.join(map(str, seeds))})" for name, seeds in cases.SEED_SETS.items())
        + "; default: first. The second set is for final tests only: do not use it during development",
    )
    one.add_argument(
        "--change",
        type=_change,
        default="none",
        metavar="KIND:SEED",
        help="rounded:S, pictures as another machine may have rounded them; dithered:S, with noise of half a grey level; "
        "shuffled:S, in another order; lossy:S, one in twenty mirrored; S: 1, 2, ...",
    )
    one.add_argument(
        "--fault",
        choices=[tree_faults.NONE, *tree_faults.FAULTS],
        default=tree_faults.NONE,
        help="deliberate fault of the found roots, at which the gate must shut (default: %(default)s)",
    )
    one.add_argument("--list", action="store_true", help="list the cases and exit")
    one.add_argument(
        "--kept", action="store_true", help="only cases that an earlier run with the same code measured; the others are skipped"
    )
    one.add_argument("--afresh", action="store_true", help="repeat measurements of an earlier run with the same code")


def _add_profiles_and_methods(one: argparse.ArgumentParser) -> None:
    one.add_argument("--profiles", type=_choices(cases.PROFILES), metavar="NAME,...", help=f"only these of {', '.join(cases.PROFILES)}")
    one.add_argument("--methods", type=_choices(cases.METHODS), metavar="NAME,...", help=f"only these of {', '.join(cases.METHODS)}")


def _change(text: str) -> str:
    kind, _, seed = text.partition(":")
    if text != "none" and (kind not in CHANGES or not seed.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(f'{name}:SEED' for name in CHANGES)}, none")
    return text


def _words(text: str) -> tuple[str, ...]:
    words = tuple(word for word in text.split(",") if word)
    if not words:
        raise argparse.ArgumentTypeError("is empty")
    return words


def _rings(text: str) -> tuple[int, ...]:
    return tuple(int(word) for word in _choices(("1", "2"))(text))


def _choices(allowed: Sequence[str]) -> Callable[[str], tuple[str, ...]]:
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
