"""What the benchmarks' command line takes."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import cases, mixtures, scatter


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
        if name == "speed":
            _add_ratios(one)
    _add_scatter(what.add_parser("scatter", help=_SCATTER, description=_SCATTER))
    compared = what.add_parser("compare", help="two runs of the ladder on the same pictures")
    compared.add_argument("before", type=Path, metavar="A.json", help="what `accuracy -o A.json` wrote before the change")
    compared.add_argument("after", type=Path, metavar="B.json", help="the same after it; cases that only one of them has are left out")
    compared.add_argument("--method", choices=cases.METHODS, default="coverage", help="default: %(default)s")
    mixed = what.add_parser("mixtures", help=_MIXTURES, description=_MIXTURES)
    mixed.add_argument("--count", type=int, default=mixtures.COUNT, metavar="N", help="default: %(default)s")
    mixed.add_argument("--first", type=int, default=0, metavar="K", help="begin with this one (default: %(default)s)")
    mixed.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    mixed.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON, and a table beside it (.md)")
    _add_view(what.add_parser("view", help=_VIEW, description=_VIEW))
    _add_damages(what.add_parser("damages", help=_DAMAGES, description=_DAMAGES))
    _add_thesis(what.add_parser("thesis", help=_THESIS, description=_THESIS))
    _add_growth(what.add_parser("growth", help=_GROWTH, description=_GROWTH))
    _add_batch(what.add_parser("batch", help=_BATCH, description=_BATCH))
    printed = what.add_parser("fingerprints", help="write what `rhizotwin bench make` compares a rendered benchmark with")
    printed.add_argument("name", metavar="NAME", help="of the benchmark, such as quick-1")
    printed.add_argument("folder", type=Path, metavar="FOLDER", help="where `rhizotwin bench make` rendered it")
    adopted = what.add_parser("adopt", help="take rendered datasets into the cache, if and only if they are what it would render")
    adopted.add_argument(
        "folders", type=Path, nargs="+", metavar="DATASET", help="folders that `rhizotwin simulate` or an older cache made"
    )
    adopted.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    return made


_THESIS = (
    "one page: the thesis's table 4.1 and figures 3.10, 4.1 and 5.3 beside its method as re-implemented and ours, "
    "and which of its assumptions turn the error; a stopped run goes on where it stopped, and what the ladder measured is kept"
)


def _add_thesis(one: argparse.ArgumentParser) -> None:
    one.add_argument("--profile", choices=cases.PROFILES, default="clean", help="of the radishes' pictures (default: %(default)s)")
    one.add_argument("--committed", action="store_true", help="take the radishes' volumes from the ladder's committed baseline")
    one.add_argument("--kept", action="store_true", help="take what was measured before and run nothing; what is missing is a dash")
    one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    one.add_argument("-o", "--output", type=Path, metavar="FILE.md", help="the page; figures go beside it (default: the cache folder)")


_GROWTH = (
    "one plant reconstructed on six days: are its roots known again, how fast do they grow; "
    "do two treatments differ, and does the interval of a dose response hold, by true lengths with a scan's error; finished days are kept"
)


def _add_growth(one: argparse.ArgumentParser) -> None:
    one.add_argument("--profile", choices=cases.PROFILES, default="bench", help="of the plant's pictures (default: %(default)s)")
    one.add_argument("--sets", type=int, default=20, metavar="N", help="sets of plants, each measured (default: %(default)s)")
    one.add_argument("--no-pictures", action="store_true", help="only treatments and doses, which render and reconstruct nothing")
    one.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute (default: %(default)s)")
    one.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON (default: the cache folder)")


_BATCH = "eighteen small scans in one batch whose worker is killed and of which one is damaged: results, sentences, the batch's own time"


def _add_batch(one: argparse.ArgumentParser) -> None:
    one.add_argument("--job-s", type=float, default=60.0, metavar="S", help="what a real scan takes, for the share (default: %(default)s)")
    one.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write every number as JSON (default: the cache folder)")


_VIEW = "the viewer and the report in a real browser (Chromium): first picture, answers to clicks, memory, volume after corrections, size"


def _add_view(one: argparse.ArgumentParser) -> None:
    one.add_argument("results", type=Path, nargs="+", metavar="RESULT", help="folders that `rhizotwin reconstruct` wrote")
    one.add_argument("--dataset", type=Path, metavar="DATASET", help="where the pictures are, if they have moved")
    one.add_argument("--clean", type=Path, metavar="RESULT", help="of the same scan without debris: what there is more is clicked away")
    one.add_argument("--repeats", type=int, default=3, metavar="N", help="starts whose median is told (default: %(default)s)")
    one.add_argument("-o", "--output", type=Path, metavar="FILE", help="write every number as JSON, too")


def _add_ratios(one: argparse.ArgumentParser) -> None:
    one.add_argument("--against", metavar="COMMIT", help="check this commit out beside and alternate runs: processor time and memory")
    one.add_argument("--jobs", type=_words, metavar="NAME,...", help="only these of --against's jobs (a wrong name lists them)")
    one.add_argument("--repeats", type=int, default=3, help="pairs of runs a job of --against (default: %(default)s)")
    one.add_argument(
        "--scaling",
        action="store_true",
        help="how processor time and memory grow with views, pixels, length of roots and finer voxels, one at a time; a figure beside -o",
    )
    one.add_argument("--axes", type=_words, metavar="NAME,...", help="only these of --scaling's axes (a wrong name lists them)")


_MIXTURES = "small drawn plants with drawn troubles: how often the interval of trusted scans holds; a stopped run goes on where it stopped"
_DAMAGES = "one clean scan, spoilt as laboratories spoil theirs: is a wrong volume ever called trusted?"
_SCATTER = "how far numbers move when only the pictures' last bits do: the gate's tolerances, and how often it opens; a stopped run goes on"


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
    one.add_argument(
        "--change",
        choices=(scatter.ROUNDED, "lossy"),
        default=scatter.ROUNDED,
        help="lossy: one picture in twenty mirrored; how often the gate shuts, and nothing is recorded (default: %(default)s)",
    )
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
