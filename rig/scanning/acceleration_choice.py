"""Choice of the table's acceleration, and of the pause before each picture, that minimise the time per view."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.rig_file import TurntablePart
from rhizotwin.rig.scanning.scan_turntable import ScanTurntable
from rhizotwin.rig.scanning.settling_time import MARGIN, WATCH_S, measure_settling_time, take_series
from rhizotwin.scenes.picture_codec import Grey

GENTLER = (1.0, 0.5, 0.25, 0.125)
"""Factors by which the acceleration of the rig file is multiplied, in the order in which they are tried. A smaller
factor is tried only if it could shorten the time per view. A turn of 9 deg takes 0.8 s at 60 deg/s2, and 2.2 s at an
eighth of this acceleration."""


@dataclass(frozen=True, kw_only=True)
class TurnTiming:
    """Duration of a turn between adjacent views, and of the pause after it."""

    acceleration_deg_per_s2: float
    turn_s: float
    moves_s: float | None
    """Time for which the contents of the picture move after the table has stopped, s. It is None if they still move
    when the measurement ends."""
    rest_s: float
    """Pause before each picture, s."""

    @property
    def view_s(self) -> float:
        """Time from the beginning of a turn to its picture, s.

        If the contents of the picture still move when the measurement ends, a large penalty is added.
        """
        return self.turn_s + self.rest_s + (0.0 if self.moves_s is not None else 1e3)

    def text(self) -> str:
        """Return a description of the result."""
        at = f"at {self.acceleration_deg_per_s2:g} deg/s2"
        if self.moves_s is None:
            return (
                f"{at} and above, the picture still moves {WATCH_S:g} s after a turn; "
                f"reduce speed_deg_per_s or acceleration_deg_per_s2. The pause before each picture is {self.rest_s:.2f} s"
            )
        return f"{at} the picture moves for {self.moves_s:.2f} s after a turn; the pause before each picture is {self.rest_s:.2f} s"


def choose_acceleration(
    turntable: ScanTurntable, look: Callable[[], Grey], clock: Clock, *, angles_deg: Sequence[float], part: TurntablePart
) -> TurnTiming:
    """Choose and set the acceleration with which a view takes the shortest time.

    After turns at several accelerations, it is measured how long the contents of the picture move.

    Parameters
    ----------
    turntable : ScanTurntable
        Turntable with a known angle.
    look : callable
        Function that takes a picture.
    clock : Clock
        Clock for waiting times.
    angles_deg : (N,) float
        Table angles of at least two successive views. Each trial turns from one angle to the next.
    part : TurntablePart
        Section of the rig file with the maximum acceleration and the minimum pause.

    Returns
    -------
    TurnTiming
        Trial with the shortest time from the beginning of a turn to its picture.
    """
    turntable.accelerate(part.acceleration_deg_per_s2)
    turntable.turn(angles_deg[0])
    clock.sleep(WATCH_S)  # so that the first trial is not affected by this turn
    best: TurnTiming | None = None
    for share, angle_deg in zip(GENTLER, angles_deg[1:], strict=False):
        tried = share * part.acceleration_deg_per_s2
        turntable.accelerate(tried)
        begun_s = clock.now_s()
        turntable.turn(angle_deg)
        turn_s = clock.now_s() - begun_s
        moves_s = measure_settling_time(*take_series(look, clock)).rest_s
        rest_s = max(part.settle_s, WATCH_S if moves_s is None else MARGIN * moves_s)
        found = TurnTiming(acceleration_deg_per_s2=tried, turn_s=turn_s, moves_s=moves_s, rest_s=rest_s)
        if best is None or found.view_s < best.view_s or best.moves_s is None:
            best = found
        if turn_s + part.settle_s >= best.view_s:  # lower accelerations take even longer
            break
    if best is None:
        raise ValueError(f"{angles_deg=} but at least two angles are required")
    turntable.accelerate(best.acceleration_deg_per_s2)
    return best
