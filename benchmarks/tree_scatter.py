"""Scatter of the tree: how much length, order and tips change with the pictures' rounding, noise and order.

None of these changes is a reason for another tree; a large range shows decisions that rounding turns.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import accuracy, commits, frozen, reconstructions
from benchmarks.cases import Case
from benchmarks.output import markdown, stored_json, value_at
from benchmarks.run import Say
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError

PATH = Path(__file__).with_name("scatter_frozen.json")
SCHEMA_VERSION = 1
CHANGES = ("rounded", "dithered", "rounded", "shuffled")
"""Changes of the pictures (`benchmarks.perturb`) in turn: every second run is rounded as by another processor."""
_NUMBERS = (
    ("length", "roots.length_error", 100.0, "+.1f", "%"),
    ("correct order", "topology.order_length", 100.0, ".1f", "%"),
    ("main roots", "topology.main_length", 100.0, ".1f", "%"),
    ("identity", "topology.identity", 1.0, ".3f", ""),
    ("tips, precision", "roots.tip_precision", 1.0, ".3f", ""),
    ("tips, recall", "roots.tip_recall", 1.0, ".3f", ""),
    ("ghosts", "topology.ghosts_mm", 1.0, ".1f", "mm"),
    ("doubled", "topology.doubled_mm", 1.0, ".1f", "mm"),
    ("volume", "volume_error", 100.0, "+.2f", "%"),
)
"""Rows of the table: title, path in the score, factor, format and unit."""

Stored = dict[str, Any]


def measure(names: Sequence[str], *, runs: int, device: str, say: Say) -> Stored:
    """Reconstruct frozen cases from changed pictures, and return their numbers.

    Parameters
    ----------
    names : sequence of str
        Names of the cases, keys of `frozen.CASES`.
    runs : int
        Number of changed runs, beside one of the unchanged pictures.
    device : str
        Computing device.
    say : Say
        Receives the progress.

    Returns
    -------
    dict
        Commit and changes, and the values of every number by case; the first value is that of the unchanged pictures.

    Raises
    ------
    UserError
        If a name is unknown, or a run failed.
    """
    frozen.check_names(names, [name for name, pictures in frozen.CASES.items() if pictures is not None])
    counts = dict.fromkeys(CHANGES, 0)
    changes = [reconstructions.UNCHANGED]
    for number in range(runs):
        kind = CHANGES[number % len(CHANGES)]
        counts[kind] += 1
        changes.append(f"{kind}:{counts[kind]}")
    cases = {name: Case(pictures=pictures) for name in names if (pictures := frozen.CASES[name]) is not None}
    values: dict[str, dict[str, list[float | None]]] = {name: {title: [] for title, *_ in _NUMBERS} for name in names}
    commit = ""
    for change in changes:
        say(change)
        run = accuracy.measure(list(cases.values()), device=device, say=say, change=change)
        if run.crashed:
            raise UserError(f"{next(iter(run.crashed))} crashed under {change}; nothing is recorded.")
        for name, case in cases.items():
            record = run.details[case.name]
            commit = record["commit"]
            for title, path, *_ in _NUMBERS:
                values[name][title].append(value_at(record["score"], path))
    return {"schema_version": SCHEMA_VERSION, "commit": commit, "changes": changes, "cases": values}


def table(stored: Stored) -> str:
    """Return the value for the unchanged pictures and the range over all runs, by case, as a Markdown table."""
    names = list(stored["cases"])
    rows = [
        [f"{title}{f' ({unit})' if unit else ''}", *(_range(stored["cases"][name][title], factor, form) for name in names)]
        for title, _, factor, form, unit in _NUMBERS
    ]
    return markdown(" | ".join(["number", *(f"`{name}`" for name in names)]), rows)


def _range(values: Sequence[float | None], factor: float, form: str) -> str:
    known = [factor * value for value in values if value is not None]
    if len(known) < len(values):
        return "-"
    return f"{known[0]:{form}} ({min(known):{form}} to {max(known):{form}})"


def section(stored: Mapping[str, Any]) -> str:
    """Return the section of the documentation's page; empty without measurements."""
    if not stored:
        return ""
    return f"""
## Scatter of the tree

Each case was reconstructed {len(stored["changes"])} times (commit {stored["commit"]}): from its pictures, with the rounding of another
processor, with noise of half a grey level, and with its pictures in another order. None of this is a reason for another tree. The
cells show the value for the unchanged pictures, and in brackets the smallest and the largest of all runs
(`./run bench scatter --frozen {",".join(stored["cases"])}`).

{table(dict(stored))}
"""


def write(stored: Stored, path: Path = PATH) -> None:
    """Record measurements; raise UserError if they were made with a modified reconstruction."""
    commits.check(stored["commit"], "the scatter of the tree")
    atomic.write_json(path, stored)


def read(path: Path = PATH) -> Stored:
    """Return the recorded measurements, empty if there are none; raise UserError if the file is damaged."""
    if not path.is_file():
        return {}
    with stored_json(path, SCHEMA_VERSION, "make it with `./run bench scatter --frozen`") as stored:
        if not stored["commit"] or not table(stored):
            raise ValueError("the commit is missing")
    return stored
