"""Benchmark results: file reader, tables of several methods, and comparison with a baseline."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.bench.run_method import SCHEMA, State
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.reading import read_file

STATES: tuple[State, ...] = ("done", "failed", "timeout", "nothing", "unreadable")


_LARGEST = sys.float_info.max
"""Largest number that is accepted in a file. An integer in JSON may exceed the range of a float."""


@dataclass(frozen=True)
class Quantity:
    """Quantity in the results of a case.

    Its tolerances are used in the comparison with a baseline.
    """

    name: str
    heading: str
    places: tuple[tuple[str, ...], ...]
    """Paths at which the value may be stored in the nested dictionary of a row. The first path that exists is used."""
    scale: float
    """Factor that converts the value to the unit in the heading."""
    digits: int
    """Number of decimal places in tables."""
    larger_is_better: bool = False
    relative: float = 0.0
    """Relative tolerance, as a fraction of the value in the baseline. It is added to the absolute tolerance."""
    absolute: float = 0.0
    """Absolute tolerance, in the unit of the stored value."""


QUANTITIES = (
    Quantity(
        "volume_error", "volume, %",
        (("traits", "traits", "volume", "error"), ("mesh", "volume_error"), ("voxels", "volume_error")), 100, 2, absolute=0.005,
    ),
    Quantity(
        "volume_interval_score", "interval score", (("traits", "traits", "volume", "interval_score"),), 1, 3, relative=0.2, absolute=0.01
    ),
    Quantity("iou", "IoU", (("mesh", "iou"), ("voxels", "iou")), 1, 3, larger_is_better=True, absolute=0.01),
    Quantity(
        "surface_median_mm", "surface, mm",
        (("mesh", "surface", "median_mm"), ("voxels", "surface", "median_mm"), ("points", "surface", "median_mm")), 1, 3,
        relative=0.2, absolute=0.005,
    ),
    Quantity(
        "length_error", "length, %",
        (("rsml", "roots", "length_error"), ("traits", "traits", "total_length", "error")), 100, 2, absolute=0.01,
    ),
    Quantity("recall", "recall", (("rsml", "roots", "recall"),), 1, 3, larger_is_better=True, absolute=0.01),
    Quantity("precision", "precision", (("rsml", "roots", "precision"),), 1, 3, larger_is_better=True, absolute=0.01),
    Quantity("tip_recall", "tips found", (("rsml", "roots", "tip_recall"),), 1, 2, larger_is_better=True, absolute=0.03),
    Quantity("tip_precision", "tips true", (("rsml", "roots", "tip_precision"),), 1, 2, larger_is_better=True, absolute=0.03),
    Quantity("parents", "parents", (("rsml", "topology", "parents"),), 1, 2, larger_is_better=True, absolute=0.05),
    Quantity("cpu_s", "processor, s", (("cpu_s",),), 1, 1, relative=0.5, absolute=5.0),
    Quantity("memory_mib", "memory, MiB", (("memory_mib",),), 1, 0, relative=0.2, absolute=100.0),
)  # fmt: skip
"""Quantities in tables and comparisons. The tolerances are about twice the scatter of repeated runs of rhizotwin."""


@dataclass(frozen=True, kw_only=True)
class Results:
    """Results of one method on a benchmark."""

    benchmark: str
    method: str
    cameras: str | None
    rows: dict[str, dict[str, Any]]
    """Results of each case as JSON values, keyed by the name of the case."""

    @property
    def label(self) -> str:
        """Return the name of the method and of the cameras, if these are known, for tables."""
        return self.method if self.cameras is None else f"{self.method} ({self.cameras} cameras)"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Comparison of one quantity of a case with the baseline."""

    case: str
    quantity: str
    value: float | None
    baseline: float | None
    worse: bool
    sentence: str


def read(path: Path) -> Results:
    """Read and validate a file of benchmark results, which may be from an untrusted source.

    Raises
    ------
    UserError
        If the file is missing, damaged, or has another format version.
    """
    try:
        stored = json.loads(read_file(path).decode("utf-8"))
        if stored["schema_version"] != SCHEMA:
            raise UserError(
                f"{path} has the format version {stored['schema_version']!r}, but this program reads version {SCHEMA}; "
                "run the benchmark again"
            )
        rows = {str(row["case"]): dict(row) | {"case": str(row["case"])} for row in stored["rows"]}
        if len(rows) < len(stored["rows"]):
            raise ValueError("a case has several rows")
        for row in rows.values():
            if row["state"] not in STATES or not isinstance(row["scores"], dict):
                raise ValueError(f"a row has the unknown state {row['state']!r}")
        cameras = stored.get("cameras")
        return Results(
            benchmark=str(stored["benchmark"]), method=str(stored["method"]), cameras=None if cameras is None else str(cameras), rows=rows
        )
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise UserError(
            f"{path} is not a file written by 'rhizotwin bench run' or 'rhizotwin bench score' ({printable(str(error))[:200]}); "
            "run the benchmark again"
        ) from None


def value(row: dict[str, Any], quantity: Quantity) -> float | None:
    """Return the value of a quantity in a row, or None if it is missing."""
    for place in quantity.places:
        found: Any = row if len(place) == 1 else row["scores"]
        for name in place:
            found = found.get(name) if isinstance(found, dict) else None
        if isinstance(found, int | float) and not isinstance(found, bool) and abs(found) <= _LARGEST:
            return float(found)
    return None


def interval_holds(row: dict[str, Any]) -> bool | None:
    """Return whether the 90 % interval of the volume contains the true volume, or None if the row has no interval."""
    try:
        holds = row["scores"]["traits"]["traits"]["volume"]["holds"]
    except (KeyError, TypeError):
        return None
    return holds if isinstance(holds, bool) else None


def text(row: dict[str, Any], quantity: Quantity) -> str:
    """Format the value of a quantity in a row for a table.

    The text is empty if the value is missing.
    """
    found = value(row, quantity)
    if found is None:
        return ""
    sign = "+" if quantity.name.endswith("_error") else ""
    return f"{quantity.scale * found:{sign}.{quantity.digits}f}"


def markdown(several: Sequence[Results]) -> str:
    """Return a Markdown table with one row per case and method."""
    shown = [quantity for quantity in QUANTITIES if any(text(row, quantity) for one in several for row in one.rows.values())]
    head = ["benchmark", "case", "method", "interval", *(quantity.heading for quantity in shown), ""]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for one, row in ordered(several):
        cells = [one.benchmark, row["case"], one.label, held(row), *(text(row, quantity) for quantity in shown), remark(row)]
        lines.append("| " + " | ".join(printable(str(cell)).replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines)


def ordered(several: Sequence[Results]) -> list[tuple[Results, dict[str, Any]]]:
    """Return each row together with the results to which it belongs, sorted by benchmark and case."""
    pairs = [(one, row) for one in several for row in one.rows.values()]
    place = {(one.benchmark, case): number for one in reversed(several) for number, case in enumerate(one.rows)}
    return sorted(pairs, key=lambda pair: (pair[0].benchmark, place[pair[0].benchmark, pair[1]["case"]]))


def held(row: dict[str, Any]) -> str:
    """Return whether the 90 % interval of the volume contains the true volume, as a word for tables.

    The word is "holds" if it does, "misses" if it does not, and empty if the interval is unknown.
    """
    return {True: "holds", False: "misses", None: ""}[interval_holds(row)]


def remark(row: dict[str, Any]) -> str:
    """Return a remark on a row for tables.

    The remark is the reason why the row or a file has no scores, and the note that the volume is not reliable.
    Otherwise it is empty.
    """
    sentence = str(row.get("sentence", ""))
    if row["state"] != "done":
        return f"{row['state']}: {sentence}"
    return "; ".join(filter(None, [sentence, "volume marked as not reliable" if row["scores"].get("trusted") is False else ""]))


def compare(found: Results, baseline: Results) -> list[Finding]:
    """Compare results with a baseline.

    A case that is missing, or has failed although it was done in the baseline, counts as worse. So does an interval
    that no longer contains the true volume, and a volume that is no longer reliable.

    Raises
    ------
    UserError
        If results and baseline are from different benchmarks or different cameras, or no case is done in the baseline.
    """
    if found.benchmark != baseline.benchmark:
        raise UserError(
            f"the results are from the benchmark {found.benchmark}, but the baseline is from {baseline.benchmark}; "
            "give two files of the same benchmark"
        )
    if found.cameras and baseline.cameras and found.cameras != baseline.cameras:
        raise UserError(
            f"the results are from {found.cameras} cameras, but the baseline is from {baseline.cameras} cameras; "
            f"run the benchmark with --cameras {baseline.cameras}"
        )
    if not any(before["state"] == "done" for before in baseline.rows.values()):
        raise UserError("no case in the baseline was completed, so there is nothing to compare; give another baseline")
    findings = []
    for case, before in baseline.rows.items():
        row = found.rows.get(case)
        if row is None or (before["state"] == "done" and row["state"] != "done"):
            why = "is missing" if row is None else remark(row)
            findings.append(Finding(case=case, quantity="state", value=None, baseline=None, worse=True, sentence=why))
            continue
        findings += [one for quantity in QUANTITIES if (one := _finding(case, quantity, row, before)) is not None]
        if interval_holds(before) and interval_holds(row) is False:
            sentence = "the interval of the volume does not contain the true value"
            findings.append(Finding(case=case, quantity="interval", value=None, baseline=None, worse=True, sentence=sentence))
        if before["scores"].get("trusted") is True and row["scores"].get("trusted") is False:
            sentence = "the volume is marked as not reliable"
            findings.append(Finding(case=case, quantity="reliability", value=None, baseline=None, worse=True, sentence=sentence))
    return findings


def _finding(case: str, quantity: Quantity, row: dict[str, Any], before: dict[str, Any]) -> Finding | None:
    now, then = value(row, quantity), value(before, quantity)
    if then is None:
        return None
    if now is None:
        return Finding(case=case, quantity=quantity.name, value=None, baseline=then, worse=True, sentence="is missing")
    allowed = quantity.absolute + quantity.relative * abs(then)
    loss = then - now if quantity.larger_is_better else abs(now) - abs(then) if quantity.name.endswith("_error") else now - then
    sentence = f"{now:.6g}, baseline {then:.6g}, tolerance {allowed:.3g}"
    return Finding(case=case, quantity=quantity.name, value=now, baseline=then, worse=loss > allowed, sentence=sentence)


def junit(findings: Sequence[Finding], name: str) -> bytes:
    """Return the comparison with a baseline as a JUnit file, with one test case per quantity."""
    worse = sum(one.worse for one in findings)
    suite = ET.Element("testsuite", name=printable(name), tests=str(len(findings)), failures=str(worse), errors="0")
    for one in findings:
        test = ET.SubElement(suite, "testcase", classname=printable(one.case), name=one.quantity)
        if one.worse:
            ET.SubElement(test, "failure", message=printable(one.sentence))
    root = ET.Element("testsuites")
    root.append(suite)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))
