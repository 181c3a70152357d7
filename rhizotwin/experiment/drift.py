"""Monitor the drift of the rig with control charts, and estimate the effect of the drift on traits.

Quantities that every scan measures are plotted in individuals control charts. The centre line of a chart is the mean.
The control limits are 3 standard deviations from the mean, estimated from the mean moving range of successive points
divided by d2 = 1.128 (W. A. Shewhart, Economic Control of Quality of Manufactured Product, 1931; NIST/SEMATECH
e-Handbook of Statistical Methods, section 6.3.2.2).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import acos, degrees, isfinite
from typing import Any

import numpy as np

from rhizotwin.recon.results.parts import Json
from rhizotwin.rig.scanning.preflight import measure_exposure
from rhizotwin.scenes.dataset import Dataset, read_image
from rhizotwin.scenes.errors import UserError

D2 = 1.128
"""Expected absolute difference of two normally distributed values, as a multiple of their standard deviation."""
SIGMAS = 3.0
"""Distance between the control limits and the centre line, as a multiple of the standard deviation."""
LEAST_POINTS = 4
"""Minimum number of points for which control limits are computed."""
PICTURES = 4
"""Maximum number of pictures per scan in which the grey level of the panel is measured."""
SURE = 0.05
"""Significance level of the test for a trend."""


@dataclass(frozen=True, kw_only=True)
class RigNumber:
    """Quantity of the rig that every scan measures."""

    name: str
    """Identifier of the quantity, which is its key in `BY_NAME`."""
    heading: str
    """Description of the quantity for users, with its unit."""
    effects: Mapping[str, float]
    """Exponents that relate traits to the quantity, keyed by trait name. If the quantity changes by a factor, a trait
    changes by this factor to the power of its exponent. Traits without an exponent have no known relation to the
    quantity."""
    is_ratio: bool = False
    """Whether changes of the quantity are given relative to its mean. If not, they are given in the unit of the
    quantity."""


RIG_NUMBERS = (
    RigNumber(
        name="focal_scale",
        heading="focal length, relative to the calibrated one",
        effects={},
        is_ratio=True,
    ),
    RigNumber(
        name="focal_left",
        heading="focal length, part that the reconstruction has not corrected",
        effects={"total_length": 1.0, "depth": 1.0, "volume": 3.0},
        is_ratio=True,
    ),
    RigNumber(name="canister_tilt_deg", heading="tilt of the canister in the strip (deg)", effects={}),
    RigNumber(name="table_tilt_deg", heading="tilt of the canister on the table (deg)", effects={}),
    RigNumber(name="blur_px", heading="blur of the markers (px)", effects={}),
    RigNumber(name="panel_level", heading="panel, fraction of full scale", effects={}, is_ratio=True),
    RigNumber(name="table_steps_deg", heading="scatter of the table's angles (deg)", effects={}),
    RigNumber(name="n_water", heading="refractive index of the water, as measured", effects={}),
    RigNumber(name="marker_inset_px", heading="inset of the markers' edges (px)", effects={}),
    RigNumber(name="reprojection_px", heading="reprojection error of the markers (px)", effects={}),
    RigNumber(name="attenuation_per_mm", heading="attenuation of the roots (1/mm)", effects={"volume": -1.0}, is_ratio=True),
)
"""Monitored quantities of the rig. Measured lengths are proportional to the scale of the pictures, and volumes to its
cube. The volume of thin translucent roots is inversely proportional to the attenuation, because their opacity is the
product of attenuation and chord length."""
BY_NAME = {one.name: one for one in RIG_NUMBERS}
"""Monitored quantities of the rig, keyed by name."""


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Individuals control chart of a quantity."""

    times: tuple[float, ...]
    """Times of the points in ascending order, days."""
    values: tuple[float, ...]
    """Values of the monitored quantity at the times of the points."""
    centre: float
    """Centre line of the chart, which is the mean of the values."""
    sigma: float | None
    """Standard deviation estimated from the moving range. It is None if there are too few points."""
    slope_per_day: float
    """Slope of a straight line fitted to all points, per day."""
    slope_p: float
    """p value of the slope. It is 1 if there are too few points."""

    @property
    def limits(self) -> tuple[float, float] | None:
        """Lower and upper control limit. The value is None if there are too few points."""
        return None if self.sigma is None else (self.centre - SIGMAS * self.sigma, self.centre + SIGMAS * self.sigma)

    @property
    def outside(self) -> tuple[int, ...]:
        """Indices of the points outside the control limits."""
        if self.limits is None:
            return ()
        low, high = self.limits
        return tuple(i for i, value in enumerate(self.values) if not low <= value <= high)

    @property
    def has_trend(self) -> bool:
        """Whether the slope of the straight line differs significantly from zero."""
        return self.slope_p < SURE

    @property
    def change(self) -> float:
        """Estimated change of the quantity during the experiment.

        It is the larger of the change along a significant trend and the largest distance between the mean and a point
        outside the control limits. It is zero if there is neither a trend nor such a point.
        """
        trend = abs(self.slope_per_day) * (self.times[-1] - self.times[0]) if self.has_trend else 0.0
        return max([trend, *(abs(self.values[i] - self.centre) for i in self.outside)])


def rig_numbers(summary: Json) -> dict[str, float]:
    """Return the quantities of the rig that ``result.json`` contains, keyed by the names in `RIG_NUMBERS`.

    If the reconstruction corrected the focal length with the markers or the roots, ``focal_left`` is 1. The level of
    the panel is measured by `panel_level` instead.
    """
    rig: dict[str, Any] = summary.get("rig") or {}
    checks = {str(one.get("name")): one.get("value") for one in summary.get("checks") or [] if isinstance(one, dict)}
    focal = rig.get("focal_scale_found")
    applied = rig.get("focal_scale", 1.0)
    found = {
        "focal_scale": focal,
        "focal_left": focal if applied == 1.0 else 1.0,
        "canister_tilt_deg": _tilt_deg(rig.get("canister_from_strip")),
        "table_tilt_deg": _tilt_deg(rig.get("table_from_canister")),
        "blur_px": checks.get("sharpness"),
        "table_steps_deg": rig.get("table_correction_deg"),
        "n_water": rig.get("n_water_found"),
        "marker_inset_px": rig.get("marker_inset_px"),
        "reprojection_px": rig.get("reprojection_after_px"),
        "attenuation_per_mm": summary.get("root_mu_per_mm"),
    }
    numbers = {name: value for name, value in found.items() if isinstance(value, int | float) and not isinstance(value, bool)}
    return {name: float(value) for name, value in numbers.items() if isfinite(value)}


def panel_level(dataset: Dataset) -> float | None:
    """Return the grey level of the panel in the pictures of a scan, as a fraction of full scale.

    The level of a picture is the grey value that a quarter of its pixels exceed, as in the exposure check of a scan
    (`rig.scanning.preflight.measure_exposure`). The median over a few pictures is returned. It is None if the pictures
    are silhouettes or cannot be read.
    """
    frames = [frame for frame in dataset.frames if frame.kind == "root"]
    if dataset.masks or not frames:
        return None
    chosen = frames[:: max(1, len(frames) // PICTURES)][:PICTURES]
    try:
        return float(np.median([measure_exposure(read_image(dataset, frame)).bright for frame in chosen]))
    except UserError:
        return None


def chart_of(times: Sequence[float], values: Sequence[float]) -> Chart:
    """Compute an individuals control chart.

    Parameters
    ----------
    times : sequence of float
        Times of the points, days, in any order, at least one.
    values : sequence of float
        Values of the quantity at these times.
    """
    order = np.argsort(np.asarray(times, np.float64), kind="stable")
    t, x = np.asarray(times, np.float64)[order], np.asarray(values, np.float64)[order]
    enough = len(x) >= LEAST_POINTS
    sigma = float(np.abs(np.diff(x)).mean()) / D2 if enough else None
    slope, p = _trend(t, x) if enough else (0.0, 1.0)
    centre = float(np.clip(x.mean(), x.min(), x.max()))  # the mean of equal values may differ from them by rounding
    return Chart(times=tuple(t), values=tuple(x), centre=centre, sigma=sigma, slope_per_day=slope, slope_p=p)


def effect_of(chart: Chart, number: RigNumber, trait: str) -> float:
    """Return the factor by which the drift of a quantity may change a trait. It is 1 if no effect is known."""
    power = number.effects.get(trait, 0.0)
    if not power or not number.is_ratio or chart.centre <= 0.0:
        return 1.0
    return float((1.0 + chart.change / chart.centre) ** abs(power))


def _trend(t: np.ndarray[Any, Any], x: np.ndarray[Any, Any]) -> tuple[float, float]:
    """Return the slope and the p value of a straight line that is fitted to values ``x`` at times ``t``."""
    from scipy.stats import linregress

    if np.ptp(t) == 0.0 or np.ptp(x) == 0.0:
        return 0.0, 1.0
    line = linregress(t, x)
    return float(line.slope), float(line.pvalue)


def _tilt_deg(pose: Any) -> float | None:
    """Return the angle, in degrees, between the z axes of two frames.

    ``pose`` is the transform between them. The angle is None if the pose is None.
    """
    if pose is None:
        return None
    return degrees(acos(max(-1.0, min(1.0, float(pose[2][2])))))
