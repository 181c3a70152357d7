"""Extrapolation of the part of a taproot that is hidden behind the net pot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.uncertainty.budget import NINETY, Term
from rhizotwin.scenes import polyline
from rhizotwin.scenes.formatting import interval_ml
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]

_LEAST_MM = 1.0
"""Minimum length of a hidden part, mm. Shorter gaps are due to the spacing of points on the centre line."""
_STEP_MM = 0.25
"""Spacing of the cross-sections that are compared, mm. It corresponds to a few points of the centre line."""
_WINDOW = 5
"""Length of the visible taproot from which the variation of its cross-section is estimated, as a multiple of the hidden
length."""
LEAST_COSINE = 0.3
"""Minimum cosine of the angle between a taproot and the vertical. Roots at larger angles than this (73 degrees) are not
extrapolated."""


@dataclass(frozen=True, kw_only=True)
class HiddenTop:
    """Estimate of the hidden parts of taproots.

    A hidden part extends from the first visible point of a taproot up to the grid of the net pot.
    """

    length_mm: float
    """Maximum total length of the hidden parts, mm."""
    height_mm: float
    """Maximum height of the hidden parts, mm."""
    share: float
    """Fraction of the taproots' total length that is hidden. The total includes the hidden parts."""
    volume_mm3: float
    """Volume of the hidden parts, mm3, if each taproot continues with the cross-section of its uppermost visible
    part."""
    interval_mm3: tuple[float, float]
    """90 % interval of the volume of the hidden parts, mm3. The cross-section is assumed to vary over the hidden length
    as much as it varies over equal lengths of the visible part."""

    def warning(self, *, is_added: bool) -> str:
        """Return the warning about hidden parts of the taproot, with advice.

        It states the volume of these parts, and whether it is included in the stated volume.
        """
        return (
            f"up to {self.length_mm:.1f} mm of the taproot ({100.0 * self.share:.0f} % of its length) may be hidden behind the net pot, "
            "where too few views look; add a ring that looks down past the rim, such as height_mm = 10, tilt_deg = 8; if the taproot "
            f"continues with the same thickness, the volume of the hidden part is {interval_ml(*self.interval_mm3)}, "
            f"{'which is added to the volume' if is_added else 'which hull.extrapolate_taproot = true adds'}"
        )

    @property
    def term(self) -> Term:
        """Return the term of the error budget for the extrapolated volume."""
        low, high = self.interval_mm3
        return Term(
            name="taproot extrapolated",
            less_mm3=self.volume_mm3 - low,
            more_mm3=high - self.volume_mm3,
            why="the top of the taproot is hidden and extrapolated",
        )


def estimate_hidden(roots: Sequence[Root], gap_mm: Sequence[float] | Array) -> HiddenTop | None:
    """Estimate the parts of the taproots that the net pot hides.

    The result is None if no taproot is hidden.

    Parameters
    ----------
    roots : sequence of Root
        Roots without parents, canister frame.
    gap_mm : (R,) sequence of float
        Height over which each may continue above its first point (`occlusion.gaps_mm`).
    """
    parts = [part for root, gap in zip(roots, gap_mm, strict=True) if (part := _extrapolate(root, float(gap))) is not None]
    if not parts:
        return None
    length, height, volume, sigma = (np.array(column) for column in zip(*parts, strict=True))
    seen_mm = sum(polyline.length_mm(root.points_mm) for root in roots)
    reach = NINETY * float(np.hypot.reduce(sigma))
    total, hidden = float(volume.sum()), float(length.sum())
    interval = (max(0.0, total - reach), total + reach)
    return HiddenTop(
        length_mm=hidden, height_mm=float(height.max()), share=hidden / (hidden + seen_mm), volume_mm3=total, interval_mm3=interval
    )


def _extrapolate(root: Root, gap_mm: float) -> tuple[float, float, float, float] | None:
    """Return the length, the height, the volume, and the standard deviation of the volume of a root's hidden top.

    The result is None if no part of the root is hidden, or if it is not steep enough to be extrapolated.
    """
    if gap_mm <= _LEAST_MM:
        return None
    way = polyline.arc_length_mm(root.points_mm)
    window = min(_WINDOW * gap_mm, float(way[-1]))
    down = root.points_mm[0] - root.points_mm[int(np.searchsorted(way, min(gap_mm, way[-1])))]
    cosine = float(down[2] / max(np.linalg.norm(down), 1e-9))
    if cosine < LEAST_COSINE:
        return None
    length_mm = gap_mm / cosine
    at = np.arange(0.0, window, _STEP_MM)
    section = 0.25 * np.pi * np.square(np.interp(at, way, root.diameters_mm))
    apart = max(1, round(length_mm / _STEP_MM))
    change = section[apart:] - section[:-apart]
    sigma = float(np.sqrt(np.mean(np.square(change)))) if len(change) else float(section.mean())
    begin = float(section[: apart + 1].mean())
    return length_mm, gap_mm, begin * length_mm, sigma * length_mm
