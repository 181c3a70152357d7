"""Falls of the size of a plant between two days.

Roots of a living plant grow. A fall beyond the error shows that the plant died, was replaced by another one, or was
exchanged with another plant of the experiment.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf, log

import numpy as np

from rhizotwin.experiment.compare import Observation
from rhizotwin.experiment.measured import IN_90

UNKNOWN = 0.03
"""Standard deviation of the logarithm of a size without an interval. The comparison of treatments was tested with
lengths of this error (docs/growth.md)."""


_Step = tuple[Observation, Observation]
"""Sizes of a plant on two consecutive days."""


@dataclass(frozen=True, kw_only=True)
class Fall:
    """Fall of the size of a plant."""

    before: Observation
    """Last size before the fall."""
    after: Observation
    """First size after the fall."""
    partner: str = ""
    """Plant with which an exchange would explain the fall. It is empty if there is none."""


def find_falls(sizes: Sequence[Observation]) -> list[Fall]:
    """Find the falls between consecutive days that exceed the error of the two sizes.

    The error is the end of the one-sided 95 % interval of the ratio of both sizes. Unknown errors are assumed to be
    `UNKNOWN`. Two plants have been exchanged if, after exchanging them again, neither falls and both grow more like the
    others.

    Parameters
    ----------
    sizes : sequence of Observation
        Sizes in any unit, which are zero if nothing of the plant was found. The days of each plant are in ascending
        order.
    """
    intervals: dict[tuple[float, float], dict[str, _Step]] = {}
    last: dict[str, Observation] = {}
    for b in sizes:
        a = last.get(b.plant)
        if a is not None and a.value > 0.0:
            intervals.setdefault((a.day, b.day), {})[b.plant] = (a, b)
        last[b.plant] = b
    return [fall for steps in intervals.values() for fall in _find_in_interval(steps)]


def _find_in_interval(steps: Mapping[str, _Step]) -> Iterator[Fall]:
    """Yield the falls between two days."""
    for plant, (a, b) in steps.items():
        others = {other: step for other, step in steps.items() if other != plant}
        growth = [change for step in others.values() if (change := _change(*step)) > -inf] or [0.0]
        usual = float(np.median(growth))
        if not _has_fallen(a, b):
            continue
        likely = {}
        for other, (c, d) in others.items():
            now, then = (hypot(*(_change(*step) - usual for step in both)) for both in (((a, b), (c, d)), ((a, d), (c, b))))
            if then < now and not _has_fallen(a, d) and not _has_fallen(c, b):
                likely[then] = other
        yield Fall(before=a, after=b, partner=likely[min(likely)] if likely else "")


def _has_fallen(a: Observation, b: Observation) -> bool:
    return -_change(a, b) > IN_90 * hypot(a.log_sigma or UNKNOWN, b.log_sigma or UNKNOWN)


def _change(a: Observation, b: Observation) -> float:
    """Return the change of the logarithm from one size to another. It is -inf if nothing is left."""
    return log(b.value / a.value) if b.value > 0.0 else -inf


def suspects(falls: Mapping[str, Sequence[Fall]]) -> list[str]:
    """Return the names of the plants that fell or were exchanged, from the falls of each quantity."""
    named = (name for own in falls.values() for one in own for name in (one.before.plant, one.partner) if name)
    return sorted(set(named))


def sentences(falls: Mapping[str, Sequence[Fall]]) -> list[str]:
    """Return a sentence for each plant and day with a fall, from the falls of each quantity, such as ``volume_mm3``."""
    found: dict[tuple[str, float], list[tuple[str, Fall]]] = {}
    for quantity, own in falls.items():
        for one in own:
            found.setdefault((one.before.plant, one.after.day), []).append((quantity, one))
    told = []
    for (plant, day), pairs in sorted(found.items()):
        sizes = " and ".join(f"{quantity} fell from {one.before.value:.4g} to {one.after.value:.4g}" for quantity, one in pairs)
        partner = next((one.partner for _, one in pairs if one.partner), "")
        cause = f"it may have been exchanged with plant {partner}" if partner else "it may have died or been replaced"
        told.append(f"plant {plant}, day {day:g}: {sizes} since day {pairs[0][1].before.day:g}, by more than the error; {cause}")
    return told
