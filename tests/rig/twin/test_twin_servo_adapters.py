"""The two servo protocols as the twin speaks them; frames byte by byte from the vendors' manuals."""

from rhizotwin.rig.twin.imperfections import CLEAN
from rhizotwin.rig.twin.lsc_adapter import LscAdapter
from rhizotwin.rig.twin.lx_adapter import LxAdapter
from rhizotwin.rig.twin.servo import Servo, Supply


def servos(*numbers: int, start: float = 500.0) -> dict[int, Servo]:
    return {number: Servo(start_counts=start, imperfections=CLEAN, key=(0, number)) for number in numbers}


class _Bus:
    """Servos on a bus, fed by hand; bytes are written as hexadecimal digits."""

    adapter_type: type = LxAdapter

    def __init__(self, *numbers: int, start: float = 500.0) -> None:
        self.servos = servos(*numbers, start=start)
        self.supply = Supply(key=(0,))
        self.adapter = self.adapter_type(self.servos, self.supply)

    def send(self, sent: str) -> str:
        return b"".join(reply.data for reply in self.adapter.receive(bytes.fromhex(sent), 0.0)).hex(" ")

    def wait(self, seconds: float) -> None:
        for unit in self.servos.values():
            unit.advance(seconds)

    def counts(self) -> list[int]:
        return [unit.counts for unit in self.servos.values()]


ASK_POS, POS_IS_500 = "55 55 01 03 1c df", "55 55 01 05 1c f4 01 e8"
TO_500 = "55 55 01 07 01 f4 01 e8 03 16"


def test_lx_examples() -> None:
    bus = _Bus(1)
    assert bus.send(ASK_POS) == POS_IS_500
    bus.servos[1] = servos(1, start=-3.0)[1]
    assert bus.send(ASK_POS) == "55 55 01 05 1c fd ff e1"
    assert bus.send("55 55 fe 03 0e f0") == "55 55 01 04 0e 01 eb"
    bus.servos[1].heat(31.0)
    assert bus.send("55 55 01 03 1a e1") == "55 55 01 04 1a 1f c1"
    bus.supply._volt = 7.4
    assert bus.send("55 55 01 03 1b e0") == "55 55 01 05 1b e8 1c da"
    for switch, torque in (("55 55 01 04 1f 01 da", "01 d9"), ("55 55 01 04 1f 00 db", "00 da")):
        assert bus.send(switch) == ""
        assert bus.send("55 55 01 03 20 db") == f"55 55 01 04 20 {torque}"
    bus.send("55 55 01 04 0d 09 e4")
    assert set(bus.servos) == {9}


def test_lx_moves_at_once_and_stops_where_it_is() -> None:
    bus = _Bus(1, start=400.0)
    assert bus.send(TO_500) == ""
    bus.wait(0.25)
    assert bus.send("55 55 01 03 02 f9") == "55 55 01 07 02 f4 01 e8 03 15"
    bus.send("55 55 01 03 0c ef")
    bus.wait(5.0)
    assert bus.counts() == [425]


def test_lx_waits_for_the_common_start() -> None:
    bus = _Bus(1, 2, start=400.0)
    for sent in ("55 55 01 07 07 f4 01 e8 03 10", "55 55 02 07 07 f4 01 e8 03 0f"):
        bus.send(sent)
    bus.wait(2.0)
    assert bus.counts() == [400, 400]
    assert bus.send("55 55 01 03 08 f3") == "55 55 01 07 08 f4 01 e8 03 0f"
    assert bus.send("55 55 fe 03 0b f3") == ""
    bus.wait(1.0)
    assert bus.counts() == [500, 500]


def test_lx_limits_are_kept_and_clamp() -> None:
    bus = _Bus(1)
    assert bus.send("55 55 01 03 15 e6") == "55 55 01 07 15 00 00 e8 03 f7"
    bus.send("55 55 01 07 14 64 00 84 03 f8")
    bus.send("55 55 01 07 01 e8 03 00 00 0b")
    bus.wait(2.0)
    assert bus.counts() == [900]
    assert bus.send("55 55 01 03 17 e4") == "55 55 01 07 17 64 19 e0 2e 55"
    assert bus.send("55 55 01 03 19 e2") == "55 55 01 04 19 55 8c"


class _Board(_Bus):
    """Servos behind a controller board."""

    adapter_type = LscAdapter


MOVE_1_TO_500 = "55 55 08 03 01 e8 03 01 f4 01"


def test_lsc_examples() -> None:
    board = _Board(1, 2, start=400.0)
    for bad in ("55 55 04 15 06 01", "55 55 05 03 01 e8 03"):  # of another length
        assert board.send(bad) == ""
    assert board.send(MOVE_1_TO_500) == ""
    board.wait(1.0)
    assert board.counts() == [500, 400]
    board.servos[2] = servos(2, start=-2.0)[2]
    assert board.send("55 55 05 15 02 01 02") == "55 55 09 15 02 01 f4 01 02 fe ff"
    assert board.send("55 55 05 15 02 01 09") == "55 55 06 15 01 01 f4 01"  # leaves out what is not there
    board.supply._volt = 7.5
    assert board.send("55 55 02 0f") == "55 55 04 0f 4c 1d"
    for sent, holds in ((MOVE_1_TO_500, True), ("55 55 09 14 06 01 02 03 04 05 06", False), (MOVE_1_TO_500, True)):
        board.send(sent)
        assert board.servos[1].holds == holds
