"""How gently the table turns and how long each picture waits, chosen by what is soonest at rest before this camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.rig_file import TurntablePart
from rhizotwin.rig.scanning.settling import MARGIN, WATCH_S, settling, watch
from rhizotwin.rig.scanning.turning import Turning
from rhizotwin.scenes.pictures import Grey

GENTLER = (1.0, 0.5, 0.25, 0.125)
"""Shares of the rig file's acceleration that are tried, one after the other, for as long as a view could be sooner
ready by it. A turn of 9 degrees at 60 degrees a second squared takes 0.8 s, at an eighth of it 2.2 s."""


@dataclass(frozen=True, kw_only=True)
class Resting:
    """What a turn by one view's step, and the rest after it, take."""

    acceleration_deg_per_s2: float
    turn_s: float
    moves_s: float | None
    """For so long the picture moved after the stop; None: to the end of the watch."""
    rest_s: float
    """What each picture waits."""

    @property
    def view_s(self) -> float:
        """From the beginning of a turn to its picture; what never came to rest is worse than all that did."""
        return self.turn_s + self.rest_s + (0.0 if self.moves_s is not None else 1e3)

    def text(self) -> str:
        """Say what was found."""
        at = f"at {self.acceleration_deg_per_s2:g} deg/s2"
        if self.moves_s is None:
            return (
                f"{at} and above the picture still moves {WATCH_S:g} s after a turn: a slower speed_deg_per_s or a gentler "
                f"acceleration_deg_per_s2 is needed; each picture waits {self.rest_s:.2f} s"
            )
        return f"{at} the picture moves for {self.moves_s:.2f} s after a turn; each picture waits {self.rest_s:.2f} s"


def choose(turning: Turning, look: Callable[[], Grey], clock: Clock, *, angles_deg: Sequence[float], part: TurntablePart) -> Resting:
    """Turn by a view's step at one acceleration after the other, watch the picture, and keep the table at the best.

    Parameters
    ----------
    turning : Turning
        The table; its angle is known.
    look : callable
        Takes a picture.
    clock : Clock
        In which it turns and rests.
    angles_deg : (N,) float
        The next views' angles, two or more; a trial turns from one to the next.
    part : TurntablePart
        Of the rig file: the highest acceleration, and the least rest.

    Returns
    -------
    Resting
        With the least time from the beginning of a turn to its picture.
    """
    turning.accelerate(part.acceleration_deg_per_s2)
    turning.turn(angles_deg[0])
    clock.sleep(WATCH_S)  # so that no trial sees what an earlier turn left
    best: Resting | None = None
    for share, angle_deg in zip(GENTLER, angles_deg[1:], strict=False):
        tried = share * part.acceleration_deg_per_s2
        turning.accelerate(tried)
        begun_s = clock.now_s()
        turning.turn(angle_deg)
        turn_s = clock.now_s() - begun_s
        moves_s = settling(*watch(look, clock)).rest_s
        rest_s = max(part.settle_s, WATCH_S if moves_s is None else MARGIN * moves_s)
        found = Resting(acceleration_deg_per_s2=tried, turn_s=turn_s, moves_s=moves_s, rest_s=rest_s)
        if best is None or found.view_s < best.view_s or best.moves_s is None:
            best = found
        if turn_s + part.settle_s >= best.view_s:  # what is gentler turns longer
            break
    if best is None:
        raise ValueError(f"{angles_deg=} but expected two or more")
    turning.accelerate(best.acceleration_deg_per_s2)
    return best
