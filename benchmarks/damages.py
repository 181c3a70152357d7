"""Stress tests: one clean scan with typical errors of laboratories, and the reactions of the reconstruction.

A trial fails if the volume is wrong, its interval misses the truth, and it is trusted nevertheless.
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks import cases, datasets
from benchmarks.damaged_scan import Damage, Scan
from benchmarks.damages_light import LIGHT
from benchmarks.damages_place import PLACE, exchange_picture
from benchmarks.output import markdown
from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.recon.results.result import Result
from rhizotwin.scenes.errors import UserError

WRONG = 0.04
"""Error beyond which a volume is wrong: that of the thesis's print was 11 %, and a week's growth is some 30 %."""

Record = dict[str, Any]


def clean_scan(scene: str) -> Path:
    """Return the folder of a clean scan of the quick ladder, rendered if it is not in the cache."""
    return datasets.make(_clean_pictures(scene)[0])


def other_pictures(scene: str) -> cases.Pictures:
    """Return pictures of another scene that have the size of a scene's clean scan."""
    image_wh = _clean_pictures(scene)[0].image_wh
    return replace(next(other for other in _clean_pictures("*") if other.scene != scene), image_wh=image_wh)


def _clean_pictures(scenes: str) -> list[cases.Pictures]:
    return [case.pictures for case in cases.quick(scenes=(scenes,), profiles=("clean",), methods=("coverage",))]


def catalogue(other: Callable[[], Scan]) -> tuple[Damage, ...]:
    """Return all damages; one of them takes a picture of another scan, which is read when it is applied."""
    return (*LIGHT, *PLACE, exchange_picture(other))


def measure(names: Sequence[str] | None, *, scene: str, say: Callable[[str], None]) -> list[Record]:
    """Apply each damage, or those given, to a scan and reconstruct it.

    Parameters
    ----------
    names : sequence of str or None
        Damages to apply; None for all.
    scene : str
        Library scene whose clean scan is used.
    say : callable
        Receives every verdict.

    Returns
    -------
    list of dict
        One record per damage.

    Raises
    ------
    UserError
        For an unknown name.
    """
    every = {damage.name: damage for damage in catalogue(cache(lambda: Scan.read(datasets.make(other_pictures(scene)))))}
    unknown = [name for name in names or () if name not in every]
    if unknown:
        raise UserError(f"{unknown[0]!r} is not one of the damages: {', '.join(every)}")
    chosen = [every[name] for name in names] if names else list(every.values())
    scan, records = Scan.read(clean_scan(scene)), []
    for place, damage in enumerate(chosen, start=1):
        records.append(_try(damage, scan))
        say(f"[{place}/{len(chosen)}] {line(records[-1])}")
    return records


def _try(damage: Damage, scan: Scan) -> Record:
    record: Record = {"name": damage.name, "why": damage.why, "refused": None, "crashed": None}
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="rhizotwin-damage-") as working:
        try:
            found = reconstruct(damage.write(scan, Path(working) / "scan"))
            record |= _judge(found, scan.truth.volume_mm3)
        except UserError as error:
            record["refused"] = str(error).replace(working, "...")
        except Exception:  # noqa: BLE001 - a crash is a result, and the others must still be run
            record["crashed"] = traceback.format_exc()
    return record | {"wall_s": time.perf_counter() - began}


def _judge(found: Result, true_mm3: float) -> Record:
    low, high = found.interval_mm3
    return {
        "volume_error": found.volume_mm3 / true_mm3 - 1.0,
        "interval": [low / true_mm3 - 1.0, high / true_mm3 - 1.0],
        "trusted": found.trusted,
        "verdict": found.solid.volume.verdict,
        "warnings": list(found.warnings),
        "checks": [{"name": check.name, "state": check.state, "value": check.value, "found": check.found} for check in found.checks],
    }


def fails(record: Record) -> bool:
    """Return whether a trial crashed, or an invalid volume (wrong and outside its interval, or NaN) is trusted."""
    if record["crashed"] is not None:
        return True
    if record["refused"] is not None or not record["trusted"]:
        return False
    low, high = record["interval"]
    return not abs(record["volume_error"]) <= WRONG and not low <= 0.0 <= high


def line(record: Record) -> str:
    """Return one line with the result of a trial."""
    if record["crashed"] is not None:
        return f"{record['name']}: CRASHED\n{record['crashed']}"
    if record["refused"] is not None:
        return f"{record['name']}: refused: {record['refused']}"
    low, high = record["interval"]
    holds = "holds" if low <= 0.0 <= high else "misses"
    trusted = "trusted" if record["trusted"] else "not trusted"
    said = "" if record["trusted"] else ": " + record["verdict"]
    lights = ", ".join(f"{check['name']} {check['value']:.3g}" for check in record["checks"] if check["state"] == "fair")
    failed = " FAILS" if fails(record) else ""
    return (
        f"{record['name']}: volume {100.0 * record['volume_error']:+.1f} %, interval [{100.0 * low:+.1f}, {100.0 * high:+.1f}] {holds}, "
        f"{trusted}{said}{f' (fair: {lights})' if lights else ''}{failed} ({record['wall_s']:.0f} s)"
    )


def table(records: Sequence[Record]) -> str:
    """Return all trials as a Markdown table."""
    rows = [(f"`{record['name']}`", record["why"], *_cells(record)) for record in records]
    return markdown("damage | cause | volume | interval | trusted | messages", rows) + "\n"


def _cells(record: Record) -> tuple[str, str, str, str]:
    if record["crashed"] is not None:
        return "crashed", "", "", ""
    if record["refused"] is not None:
        return "refused", "", "", record["refused"]
    low, high = record["interval"]
    said = record["verdict"] if not record["trusted"] else "; ".join(c["found"] for c in record["checks"] if c["state"] == "fair")
    holds = "holds" if low <= 0.0 <= high else "misses"
    verdict = "**yes**" if fails(record) else "yes" if record["trusted"] else "no"
    return f"{100.0 * record['volume_error']:+.1f} %", holds, verdict, said
