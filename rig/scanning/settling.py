"""How long pictures still move after the table has stopped: the rest that a scan needs, measured by its own camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.clock import Clock
from rhizotwin.scenes.pictures import Grey

WATCH_S = 12.0
"""So long the camera looks: water of 15 cm sloshes at 2 to 3 Hz and is still after some ten periods; roots swing more
slowly."""
LATE = 1.0 / 3.0
"""The last share of the looks, in which nothing may move any more, tells the noise."""
ABOVE_NOISE = 1.15
"""A picture that differs by this much more than by noise has moved: the rms of 1e5 pixels scatters by far less."""
MARGIN = 1.5
"""What was measured after one move is made longer by this for the others."""
STRIDE = 2
"""Every so-manieth pixel each way is looked at."""


@dataclass(frozen=True, kw_only=True)
class Settling:
    """What was seen after a stop."""

    rest_s: float | None
    """After which nothing moves beyond noise; None: it still moved at the end."""
    moved: float
    """How far the first picture differs from those at rest, over what noise makes of two that do not."""


def settling(pictures: Sequence[Grey], times_s: Sequence[float]) -> Settling:
    """Return when pictures stopped moving.

    Parameters
    ----------
    pictures : (N) of (H, W)
        In the order of time, from the stop on; at least 6.
    times_s : (N) float
        After the stop.

    Returns
    -------
    Settling
        The rest is the time of the first picture from which on none differs more than by noise from the mean of the
        late ones.

    Notes
    -----
    With M late pictures of noise s, an early one differs from their mean by ``s sqrt(1 + 1/M)`` (rms), a late one by
    ``s sqrt(1 - 1/M)``. What still swings at the end shows where the spread of the late pictures and the difference of
    neighbours, each a measure of the noise, disagree.
    """
    if len(pictures) < 6 or len(pictures) != len(times_s):
        raise ValueError(f"{len(pictures)=} and {len(times_s)=} but expected 6 or more of both")
    stack = np.stack([picture[::STRIDE, ::STRIDE].astype(np.float32) for picture in pictures])
    late = stack[-max(3, round(LATE * len(stack))) :]
    count = len(late)
    mean = late.mean(axis=0)
    noise = float(np.sqrt(np.mean((late - mean) ** 2) * count / (count - 1)))
    steps = np.diff(late, axis=0)
    stepping = float(np.sqrt(np.mean(steps**2) / 2.0))  # noise alone makes sqrt(2) of its own between neighbours
    apart = np.sqrt(np.mean((stack - mean) ** 2, axis=(1, 2)))
    floor = min(noise, stepping) * np.sqrt(1.0 + 1.0 / count)
    moving = apart > ABOVE_NOISE * max(floor, 1e-9)
    still_moves = max(noise, stepping) > ABOVE_NOISE * max(min(noise, stepping), 1e-9) or moving[-count:].any()
    last = int(np.flatnonzero(moving).max(initial=-1))
    rest = None if still_moves or last + 1 >= len(times_s) else float(times_s[last + 1])
    return Settling(rest_s=rest, moved=float(apart[0] / max(floor, 1e-9)))


def watch(look: Callable[[], Grey], clock: Clock, *, seconds: float = WATCH_S, every_s: float = 0.25) -> tuple[list[Grey], list[float]]:
    """Take pictures from now on, and return them with the times at which each was begun.

    Parameters
    ----------
    look : callable
        Takes a picture.
    clock : Clock
        For the times.
    seconds : float
        How long.
    every_s : float
        Pause from picture to picture.

    Returns
    -------
    list of (H, W) arrays, list of float
        At least six pictures, and seconds since now.
    """
    begun_s, pictures, times_s = clock.now_s(), list[Grey](), list[float]()
    while (now_s := clock.now_s() - begun_s) < seconds or len(pictures) < 6:
        times_s.append(now_s)
        pictures.append(look())
        clock.sleep(every_s - (clock.now_s() - begun_s - now_s))
    return pictures, times_s
