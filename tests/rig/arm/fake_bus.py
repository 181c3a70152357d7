"""A servo bus of a few lines for the tests of the arm."""

from collections.abc import Collection, Mapping

import pytest

from rhizotwin.rig.arm.arm import ServoArm
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import ArmPart, Joint
from tests.rig.fake_time import Time

IDS = (6, 5, 4, 3, 2)
PART = ArmPart(
    joints=(
        Joint(servo=6, min_deg=-90.0, max_deg=90.0),
        Joint(servo=5, min_deg=-86.0, max_deg=91.0, sign=-1, zero_counts=510.0),
        Joint(servo=4, min_deg=-88.0, max_deg=88.0),
        Joint(servo=3, min_deg=-119.0, max_deg=119.0, zero_counts=490.0),
        Joint(servo=2, min_deg=-112.0, max_deg=112.0),
    ),
    max_speed_deg_per_s=60.0,
    tolerance_deg=3.0,
)
MIDDLE = (0.0, 0.0, 0.0, 0.0, 0.0)
MIDDLE_COUNTS = {6: 500, 5: 510, 4: 500, 3: 490, 2: 500}
COUNTS_PER_DEG = 1000.0 / 240.0


class _Bus:
    """Servos that run at uniform speed and do what the tests set; everything that changes something is in ``log``."""

    least_move_s = 0.2

    def __init__(self, clock: Time, *, tells: bool = True) -> None:
        self.clock = clock
        self.tells = tells
        self.at: dict[int, float] = dict(MIDDLE_COUNTS)
        self.on = dict.fromkeys(IDS, False)
        self.celsius = dict.fromkeys(IDS, 30)
        self.volt = 7.5
        self.log: list[tuple[str, object]] = []
        self.moves: list[tuple[dict[int, int], float]] = []
        self.polled_in_motion = 0
        self.lose_moves = 0
        self.blocked: dict[int, float] = {}
        self.drift: dict[int, float] = {}
        self.sag: dict[int, int] = {}
        self.fail: dict[str, RigError | KeyboardInterrupt] = {}
        self.limp_on_move: int | None = None
        self.limp_always: set[int] = set()
        self._from: dict[int, float] = {}
        self._to: dict[int, float] = {}
        self._began_s = self._ends_s = 0.0

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        self._call("move", dict(targets))
        assert 0.0 <= duration_s <= 30.0
        assert all(0 <= counts <= 1000 for counts in targets.values())
        self.moves.append((dict(targets), duration_s))
        if self.lose_moves:
            self.lose_moves -= 1
            return
        self._settle()
        self._from = dict(self.at)
        self._to = {servo: self.blocked.get(servo, counts) for servo, counts in targets.items()}
        self._began_s, self._ends_s = self.clock.at_s, self.clock.at_s + duration_s
        self.on = dict.fromkeys(IDS, True)
        if self.limp_on_move is not None:
            self.on[self.limp_on_move] = False
            self._to[self.limp_on_move] = self.at[self.limp_on_move] - 60.0

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        self._call("positions")
        self.polled_in_motion += self.clock.at_s < self._ends_s - 1e-9
        self._settle()
        for servo, counts_per_read in self.drift.items():
            self.at[servo] += counts_per_read
        return {servo: round(self.at[servo]) + self.sag.get(servo, 0) for servo in ids}

    def voltage_v(self, ids: Collection[int]) -> float:
        assert tuple(ids) == IDS
        return self.volt

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int] | None:
        return {servo: self.celsius[servo] for servo in ids} if self.tells else None

    def loaded(self, ids: Collection[int]) -> dict[int, bool] | None:
        return {servo: self.on[servo] for servo in ids} if self.tells else None

    def load(self, ids: Collection[int], on: bool) -> None:
        self._call("load", on)
        self.on.update({servo: on and servo not in self.limp_always for servo in ids})

    def stop(self, ids: Collection[int]) -> None:
        self._call("stop", tuple(ids))
        self._settle()
        self._to = {}

    def describe(self) -> str:
        return "servos"

    def close(self) -> None:
        self._call("close")

    def names(self) -> list[str]:
        return [name for name, _ in self.log if name != "positions"]

    def _call(self, name: str, what: object = None) -> None:
        self.log.append((name, what))
        if name in self.fail:
            raise self.fail[name]

    def _settle(self) -> None:
        duration_s = self._ends_s - self._began_s
        part = 1.0 if duration_s <= 0.0 else min((self.clock.at_s - self._began_s) / duration_s, 1.0)
        for servo, to in self._to.items():
            self.at[servo] = self._from[servo] + (to - self._from[servo]) * part


def arm_and_bus(*, tells: bool = True, prepared: bool = True, part: ArmPart = PART) -> tuple[ServoArm, _Bus]:
    clock = Time()
    bus = _Bus(clock, tells=tells)
    arm = ServoArm(bus, part, clock)
    if prepared:
        arm.prepare()
        bus.log.clear()
        bus.moves.clear()
    return arm, bus


BOTH = pytest.mark.parametrize("tells", [True, False], ids=["tells torque", "cannot tell"])
