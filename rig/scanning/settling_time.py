"""Measurement of how long the contents of pictures move after the table stops.

The pause before each picture is derived from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.clock import Clock
from rhizotwin.scenes.picture_codec import Grey

WATCH_S = 12.0
"""Duration of the measurement, s. Water in a vessel of 15 cm sloshes at 2 to 3 Hz and is at rest after about ten
periods. Roots swing more slowly."""
LATE = 1.0 / 3.0
"""Fraction of the pictures, at the end of the series, in which nothing moves. The noise is determined from these
pictures, and they must not differ by more than noise."""
ABOVE_NOISE = 1.15
"""Minimum ratio of a picture's difference from the picture at rest to the noise. If it is exceeded, the contents have
moved. The root mean square over 1e5 pixels varies much less than this ratio."""
MARGIN = 1.5
"""Safety factor by which the measured duration is multiplied. The duration is measured after one move, and applied to
all moves."""
STRIDE = 2
"""Distance between the pixels that are used, in rows and columns."""


@dataclass(frozen=True, kw_only=True)
class SettlingTime:
    """How long and how far the contents of pictures move after the table stops."""

    rest_s: float | None
    """Time after the stop at which the motion is below the noise, s. It is None if the motion continues to the end of
    the measurement."""
    moved: float
    """Difference between the first picture and the mean picture at rest, divided by the difference due to noise."""


def measure_settling_time(pictures: Sequence[Grey], times_s: Sequence[float]) -> SettlingTime:
    """Measure the time after which the contents of pictures no longer move.

    Parameters
    ----------
    pictures : (N) of (H, W)
        At least six pictures in chronological order, beginning at the stop.
    times_s : (N) float
        Times after the stop, s.

    Returns
    -------
    SettlingTime
        ``rest_s`` is the time of the first picture after which no picture differs from the mean of the late pictures by
        more than noise.

    Notes
    -----
    With M late pictures of noise s, an early picture differs from their mean by ``s sqrt(1 + 1/M)`` (rms), and a late
    picture by ``s sqrt(1 - 1/M)``. Motion that continues to the end is detected by a disagreement of two estimates of
    the noise: the spread of the late pictures, and the difference between successive pictures.
    """
    if len(pictures) < 6 or len(pictures) != len(times_s):
        raise ValueError(f"{len(pictures)=} and {len(times_s)=} but at least 6 of both are required")
    stack = np.stack([picture[::STRIDE, ::STRIDE].astype(np.float32) for picture in pictures])
    late = stack[-max(3, round(LATE * len(stack))) :]
    count = len(late)
    mean = late.mean(axis=0)
    noise = float(np.sqrt(np.mean((late - mean) ** 2) * count / (count - 1)))
    steps = np.diff(late, axis=0)
    stepping = float(np.sqrt(np.mean(steps**2) / 2.0))  # the difference between successive pictures contains sqrt(2) times the noise
    apart = np.sqrt(np.mean((stack - mean) ** 2, axis=(1, 2)))
    floor = min(noise, stepping) * np.sqrt(1.0 + 1.0 / count)
    moving = apart > ABOVE_NOISE * max(floor, 1e-9)
    still_moves = max(noise, stepping) > ABOVE_NOISE * max(min(noise, stepping), 1e-9) or moving[-count:].any()
    last = int(np.flatnonzero(moving).max(initial=-1))
    rest = None if still_moves or last + 1 >= len(times_s) else float(times_s[last + 1])
    return SettlingTime(rest_s=rest, moved=float(apart[0] / max(floor, 1e-9)))


def take_series(
    look: Callable[[], Grey], clock: Clock, *, seconds: float = WATCH_S, every_s: float = 0.25
) -> tuple[list[Grey], list[float]]:
    """Take pictures for a given duration, and return them with their start times.

    Parameters
    ----------
    look : callable
        Function that takes a picture.
    clock : Clock
        Clock for times and pauses.
    seconds : float
        Duration of the series, s.
    every_s : float
        Interval between the starts of pictures, s.

    Returns
    -------
    list of (H, W) arrays, list of float
        At least six pictures, and the time from the call to the start of each picture, s.
    """
    begun_s, pictures, times_s = clock.now_s(), list[Grey](), list[float]()
    while (now_s := clock.now_s() - begun_s) < seconds or len(pictures) < 6:
        times_s.append(now_s)
        pictures.append(look())
        clock.sleep(every_s - (clock.now_s() - begun_s - now_s))
    return pictures, times_s
