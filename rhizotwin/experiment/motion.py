"""Motion of root tips: speed, elongation, curvature and angle to gravity over time, and circumnutation.

Full scans provide the roots, and short scans between them the positions of the tips (`tip_fit`). The series of a root
between two full scans is smoothed (`smoothing`), and rates are those of the smoothed series.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from rhizotwin.experiment.matching import Day, track_roots
from rhizotwin.experiment.measured import IN_90
from rhizotwin.experiment.smoothing import LEAST, Smoothed, smooth
from rhizotwin.experiment.tip_fit import Tip, TipFitter
from rhizotwin.scenes import subject
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.trait_table import csv_text, format_exact
from rhizotwin.stored import result_files

Array = NDArray[np.float64]

SIGMA_PX, SIGMA_DEG, SIGMA_PER_MM = 0.2, 1.3, 0.02
"""Standard deviations of constant errors of the position of a tip (in px), its angle to gravity and its curvature,
which scatter does not show. They are those of the twin with 0.26 mm per pixel (docs/timelapse.md)."""
WAVE_PX, WAVE_SHARE = 0.06, 0.15
"""Standard deviation of the error of a tip that changes with its position in the pixels, px, and of its change relative
to the path of the tip. The error has a period of about a pixel, and does not scatter between successive scans."""
COARSE_MM = 0.3
"""Size of a pixel, mm, above which the intervals were not verified. With 0.42 mm, the angle of a tip that circles was
wrong by up to 12 degrees."""
LEAST_PERIODS, LEAST_PER_PERIOD = 2.0, 4.0
"""Minimum number of periods in a series, and of scans per period, for a circumnutation."""
LEAST_SEEN = 0.5
"""Minimum fraction of the scans of a series in which a tip is seen. Ends that are not tips are seen in fewer."""
SURE, LEAST_WAVES = 0.01, 2.0
"""Maximum p value of a circumnutation, for all tried periods together, and minimum radius relative to `WAVE_PX`."""


@dataclass(frozen=True, kw_only=True)
class Nutation:
    """Elliptic motion of a tip around its path."""

    period_h: float
    period_interval_h: tuple[float, float]
    """90 % interval of the period."""
    radii_mm: tuple[float, float]
    """Half the long and half the short axis of the ellipse."""
    sigma_mm: float
    """Standard deviation of each of ``radii_mm``."""
    is_counterclockwise: bool
    """Whether the tip moves counter-clockwise, seen from above."""


@dataclass(frozen=True, kw_only=True)
class TipTrack:
    """Tip of a root in successive short scans between two full scans."""

    plant: str
    root: str
    """Name of the root, the same as in the growth of the same results."""
    order: int
    days: Array
    """Age (N,) of the plant at each scan, days."""
    tips: tuple[Tip, ...]
    """Tip in each scan."""
    px_mm: float
    """Size of a pixel at the roots, mm."""

    @property
    def hours(self) -> Array:
        """Time (N,) since the first scan, hours."""
        return np.asarray(24.0 * (self.days - self.days[0]))

    @property
    def points_mm(self) -> Array:
        """Measured positions (N, 3), canister frame, mm."""
        return np.array([tip.tip_mm for tip in self.tips])

    @cached_property
    def position(self) -> tuple[Smoothed, ...]:
        """Smoothed x, y and z, mm."""
        return tuple(smooth(self.hours, axis) for axis in self.points_mm.T)

    @cached_property
    def length(self) -> Smoothed:
        """Smoothed length of the root, mm. Its rate is the elongation, mm/h."""
        found = smooth(self.hours, np.array([tip.length_mm for tip in self.tips]))
        ends = np.sqrt(2.0) * WAVE_PX * self.px_mm / self.hours[-1]
        return replace(
            found,
            rate_sigma=np.hypot(found.rate_sigma, WAVE_SHARE * np.abs(found.rate)),
            mean_rate_sigma=float(np.hypot(found.mean_rate_sigma, ends)),
        )

    @cached_property
    def angle(self) -> Smoothed:
        """Smoothed angle between the growth direction and straight down, deg."""
        found = smooth(self.hours, np.array([tip.angle_deg for tip in self.tips]))
        return replace(found, mean_rate_sigma=float(np.hypot(found.mean_rate_sigma, SIGMA_DEG / self.hours[-1])))

    @cached_property
    def curvature(self) -> Smoothed:
        """Smoothed curvature of the end of the root, 1/mm."""
        return smooth(self.hours, np.array([tip.curvature_per_mm for tip in self.tips]))

    @property
    def speed(self) -> tuple[Array, Array]:
        """Speed (N,) of the tip, and its standard deviation (N,), mm/h."""
        rate, sigma = (np.stack([getattr(axis, name) for axis in self.position]) for name in ("rate", "rate_sigma"))
        speed = np.linalg.norm(rate, axis=0)
        share = rate / np.maximum(speed, 1e-12)
        return speed, np.sqrt((share**2 * sigma**2).sum(axis=0) + (WAVE_SHARE * speed) ** 2)

    @cached_property
    def nutation(self) -> Nutation | None:
        """Circumnutation. It is None if it is not significant."""
        return find_nutation(self.hours, self.points_mm, wave_mm=WAVE_PX * self.px_mm)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Tracks of all tips, and sentences about scans and roots that could not be measured."""

    tracks: tuple[TipTrack, ...]
    notes: tuple[str, ...]


def find_nutation(hours: Array, points_mm: Array, *, wave_mm: float) -> Nutation | None:
    """Find the period of an elliptic motion around a parabola.

    The period with the smallest residual is chosen. Its interval are the periods that an F test does not reject.

    Parameters
    ----------
    hours : (N,) array
        Ascending times.
    points_mm : (N, 3) array
        Positions of a tip, mm.
    wave_mm : float
        Standard deviation of errors that change with the position in the pixels, mm.
    """
    number = len(hours)
    span = float(hours[-1] - hours[0])
    shortest = LEAST_PER_PERIOD * float(np.median(np.diff(hours)))
    longest = span / LEAST_PERIODS
    free = 3 * number - 15
    if longest <= shortest or free < 6:
        return None
    trend = np.stack([np.ones(number), hours / span, (hours / span) ** 2], axis=1)
    frequencies = np.linspace(1.0 / longest, 1.0 / shortest, 1 + 20 * int(np.ceil(span * (1.0 / shortest - 1.0 / longest))))
    fits = []
    for frequency in frequencies:
        phase = 2.0 * np.pi * frequency * hours
        basis = np.concatenate([trend, np.stack([np.cos(phase), np.sin(phase)], axis=1)], axis=1)
        waves = np.linalg.lstsq(basis, points_mm, rcond=None)[0]
        fits.append((float(((points_mm - basis @ waves) ** 2).sum()), waves[3:]))
    rest = np.array([left for left, _ in fits])
    best = int(rest.argmin())
    without = float(((points_mm - trend @ np.linalg.lstsq(trend, points_mm, rcond=None)[0]) ** 2).sum())
    ratio = (without - rest[best]) / 6.0 / max(rest[best] / free, 1e-18)
    tried = max(1.0, span * (frequencies[-1] - frequencies[0]))  # frequencies that are independent
    axes = np.linalg.svd(fits[best][1], compute_uv=False)
    if f_distribution.sf(ratio, 6, free) * tried > SURE or axes[0] < LEAST_WAVES * wave_mm:
        return None
    within = frequencies[rest <= rest[best] * (1.0 + f_distribution.ppf(0.9, 1, free) / free)]
    half = 0.5 * (frequencies[1] - frequencies[0])  # spacing of the tried frequencies
    cosine, sine = fits[best][1]
    return Nutation(
        period_h=1.0 / frequencies[best],
        period_interval_h=(1.0 / (within.max() + half), 1.0 / (within.min() - half)),
        radii_mm=(float(axes[0]), float(axes[1])),
        sigma_mm=float(np.hypot(np.sqrt(rest[best] / free * 2.0 / number), wave_mm)),
        is_counterclockwise=bool(np.cross(cosine, sine)[2] > 0.0),
    )


def measure(results: Sequence[Path], scans: Sequence[Path], *, say: Callable[[str], object] = lambda _: None) -> Motion:
    """Measure the motion of the root tips of all plants.

    Parameters
    ----------
    results : sequence of Path
        Result folders of full scans.
    scans : sequence of Path
        Datasets. Those between two full scans of the same plant, or after the last one, are measured.
    say : callable
        Function that is called with a line of text for each scan.

    Raises
    ------
    UserError
        If a result or dataset has no plant or day, or no scan is later than a result of its plant.
    """
    full: dict[str, list[_Full]] = {}
    for folder in results:
        one = _Full.read(folder)
        full.setdefault(one.plant, []).append(one)
    datasets = [load_dataset(path) for path in scans]
    tracks, notes = list[TipTrack](), list[str]()
    for plant, own in full.items():
        own.sort(key=lambda one: one.day)
        names = track_roots([Day(day=one.day, roots=one.roots) for one in own]).names
        ends = [*(one.day for one in own[1:]), np.inf]
        for one, named, end in zip(own, names, ends, strict=True):
            short = sorted((day, data) for data in datasets if _plant(data) == plant for day in [_day(data)] if one.day < day < end)
            tracks += _measure_series(one, named, dict(short), notes, say)
    if not tracks:
        raise UserError("; ".join(notes) or "no scan is later than a result of the same plant; give results of full scans, and short scans")
    return Motion(tracks=tuple(tracks), notes=tuple(notes))


@dataclass(frozen=True, kw_only=True)
class _Full:
    """Result of a full scan."""

    folder: Path
    plant: str
    day: float
    roots: tuple[Root, ...]

    @classmethod
    def read(cls, folder: Path) -> _Full:
        """Read a result folder."""
        whose = subject.from_summary(result_files.read_summary(folder), str(folder / "result.json"))
        roots = result_files.read_roots(folder)
        plant = whose.plant or " + ".join(sorted({root.plant for root in roots} - {""}))
        if not plant or whose.day is None or not roots:
            missing = "roots" if not roots else "day" if plant else "plant"
            raise UserError(f"{folder}: the result has no {missing}, which the motion of root tips requires")
        return cls(folder=folder, plant=plant, day=whose.day, roots=roots)


def _plant(dataset: Dataset) -> str:
    return dataset.scene.subject.plant or " + ".join(sorted(plant.plant for plant in dataset.scene.plants))


def _day(dataset: Dataset) -> float:
    if dataset.scene.subject.day is None:
        raise UserError(f"{dataset.folder}: the dataset has no day, which the motion of root tips requires")
    return dataset.scene.subject.day


def _measure_series(
    full: _Full, names: Sequence[str], scans: Mapping[float, Dataset], notes: list[str], say: Callable[[str], object]
) -> list[TipTrack]:
    """Return the tracks of the tips in the scans after a full scan, keyed by day in ascending order."""
    if not scans:
        return []
    fitter = TipFitter(full.folder, full.roots)
    found = dict[float, dict[int, Tip]]()
    for day, dataset in scans.items():
        try:
            found[day] = fitter.fit(dataset)
            say(f"{dataset.folder.name}: {count(len(found[day]), 'root tip')}")
        except UserError as error:
            notes.append(str(error))
    tracks = []
    for number, root in enumerate(full.roots):
        days = [day for day, tips in found.items() if number in tips]
        if root.tip_seen and len(days) >= max(LEAST, LEAST_SEEN * len(found)):
            tips = tuple(found[day][number] for day in days)
            whose = root.plant or full.plant
            tracks.append(TipTrack(plant=whose, root=names[number], order=root.order, days=np.array(days), tips=tips, px_mm=fitter.px_mm))
    if fitter.px_mm > COARSE_MM:
        notes.append(
            f"{full.plant}: the pictures have {fitter.px_mm:.2f} mm per pixel, but intervals were verified up to {COARSE_MM:g} mm; "
            "use larger pictures"
        )
    if lost := len(full.roots) - len(tracks):
        notes.append(
            f"{full.plant}: {lost} of {count(len(full.roots), 'root tip')} after day {full.day:g} were seen in fewer than {LEAST} scans"
        )
    return tracks


def tips_csv(motion: Motion) -> str:
    """Return a CSV table with one row per root and scan. Numbers have 90 % intervals, positions half its width."""
    numbers = ("speed_mm_per_h", "elongation_mm_per_h", "curvature_per_mm", "angle_deg")
    head = ["plant", "root", "order", "day", "hours", "x_mm", "y_mm", "z_mm", "position_90_mm"]
    rows: list[Sequence[str]] = [[*head, *(f"{name}{end}" for name in numbers for end in ("", "_low", "_high"))]]
    for track in motion.tracks:
        away = IN_90 * np.hypot(np.max([axis.value_sigma for axis in track.position], axis=0), SIGMA_PX * track.px_mm)
        columns = [
            *([*axis.value] for axis in track.position),
            away,
            *_with_interval(*track.speed, least=0.0),
            *_with_interval(track.length.rate, track.length.rate_sigma),
            *_with_interval(track.curvature.value, np.hypot(track.curvature.value_sigma, SIGMA_PER_MM), least=0.0),
            *_with_interval(track.angle.value, np.hypot(track.angle.value_sigma, SIGMA_DEG), least=0.0),
        ]
        for day, hours, values in zip(track.days, track.hours, zip(*columns, strict=True), strict=True):
            whose = [track.plant, track.root, str(track.order), f"{day:g}", f"{hours:.4g}"]
            rows.append([*whose, *(format_exact(float(value)) for value in values)])
    return csv_text(rows)


def tracks_csv(motion: Motion) -> str:
    """Return a CSV table with one row per root and series: mean rates and circumnutation, with 90 % intervals."""
    head = ["plant", "root", "order", "from_day", "to_day", "scans"]
    head += [f"{name}{end}" for name in ("elongation_mm_per_day", "turn_deg_per_h", "nutation_h") for end in ("", "_low", "_high")]
    rows: list[Sequence[str]] = [[*head, "nutation_mm", "nutation_mm_low", "nutation_mm_high", "nutation_short_mm", "nutation_sense"]]
    for track in motion.tracks:
        length, angle, nutation = track.length, track.angle, track.nutation
        values: list[float | None] = [24.0 * end for end in _ends(length.mean_rate, length.mean_rate_sigma)]
        values += _ends(angle.mean_rate, angle.mean_rate_sigma)
        sense = ""
        if nutation is None:
            values += [None] * 7
        else:
            long_mm, short_mm = nutation.radii_mm
            values += [nutation.period_h, *nutation.period_interval_h, *_ends(long_mm, nutation.sigma_mm), short_mm]
            sense = "counter-clockwise" if nutation.is_counterclockwise else "clockwise"
        whose = [track.plant, track.root, str(track.order), f"{track.days[0]:g}", f"{track.days[-1]:g}", str(len(track.days))]
        rows.append([*whose, *(format_exact(value) for value in values[: len(rows[0]) - len(whose) - 1]), sense])
    return csv_text(rows)


def _ends(value: float, sigma: float) -> list[float]:
    """Return a value with its 90 % interval."""
    return [value, value - IN_90 * sigma, value + IN_90 * sigma]


def _with_interval(value: Array, sigma: Array, *, least: float = -np.inf) -> list[Array]:
    """Return values (N,) with the ends of their 90 % intervals, which are not below ``least``."""
    return [value, np.maximum(value - IN_90 * sigma, least), value + IN_90 * sigma]
