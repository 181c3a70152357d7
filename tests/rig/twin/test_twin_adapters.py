"""The protocols as the twin speaks them: Marlin's lines as in its own sources, servo frames byte by byte from the vendors' manuals."""

import pytest

from rhizotwin.rig.twin.imperfections import CLEAN
from rhizotwin.rig.twin.lamps import Lamp
from rhizotwin.rig.twin.lsc_adapter import LscAdapter
from rhizotwin.rig.twin.lx_adapter import LxAdapter
from rhizotwin.rig.twin.marlin_adapter import MarlinAdapter
from rhizotwin.rig.twin.servo import Servo, Supply
from rhizotwin.rig.twin.stepper import Stepper


class _Board:
    """A board fed by hand, in its own time."""

    def __init__(self) -> None:
        self.table = Stepper(full_step_deg=1.8, imperfections=CLEAN, key=(0,))
        self.lamps = tuple(Lamp(full_rgb=(255, 255, 255), imperfections=CLEAN, key=(i,)) for i in (0, 1))
        self.adapter = MarlinAdapter(self.table, (self.lamps[0], self.lamps[1]))
        self.now_s = 0.0

    def send(self, text: str | bytes) -> list[str]:
        """Send a line; return what is answered at once."""
        data = text if isinstance(text, bytes) else text.encode() + b"\n"
        return _lines(self.adapter.receive(data, self.now_s))

    def wait(self, seconds: float) -> list[str]:
        """Let time pass; return what is said meanwhile."""
        until_s, said = self.now_s + seconds, []
        while True:
            next_s = min(self.adapter.next_s(), until_s)
            self.table.advance(next_s - self.now_s)
            self.now_s = next_s
            said += _lines(self.adapter.poll(self.now_s))
            if self.now_s >= until_s:
                return said


def _lines(replies: list) -> list[str]:
    return b"".join(reply.data for reply in replies).decode("latin-1").splitlines()


def test_the_wire_examples_are_accepted() -> None:
    board = _Board()
    said = [line for byte in b"N0 M110 N0*125\nN1 M115*39\n" for line in board.send(bytes([byte]))]
    assert said[0] == said[-1] == "ok"
    assert said[1].startswith("FIRMWARE_NAME:Marlin 2.1")
    assert "Cap:EMERGENCY_PARSER:1" in said
    for line in ("N2 G91*19", "N3 G1 X3.6 F1800*23"):
        assert board.send(line) == ["ok"]
    assert board.send("N4 M400*35") == []
    assert board.wait(0.5) == ["ok"]
    assert board.send("N5 M114*34") == ["X:3.60 Y:0.00 Z:0.00 E:0.00 Count X:64 Y:0 Z:0", "ok"]
    for line in ("N6 M150 S0 R255 U255 B255 P255*119", "N7 M150 S1 I0 R255*123"):
        assert board.send(line) == ["ok"]
    assert board.send("M9999 X1") == ['echo:Unknown command: "M9999 X1"', "ok"]
    assert [lamp.level for lamp in board.lamps] == pytest.approx([1.0, 1.0 / 90.0])


def test_a_move_is_accepted_at_once_and_waited_for_by_m400() -> None:
    board = _Board()
    assert board.send("G1 X90 F1200") == ["ok"]
    assert board.send("M114") == ["X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0", "ok"]
    assert board.send("M400") == board.send("M114") == []  # waits behind
    assert board.wait(4.8) == ["echo:busy: processing"] * 2
    assert board.wait(0.1) == ["ok", "X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:1600 Y:0 Z:0", "ok"]
    assert board.table.true_deg == pytest.approx(90.0)


class _Bus:
    """Servos on a bus, fed by hand; bytes are written as hexadecimal digits."""

    adapter_type: type = LxAdapter

    def __init__(self, *numbers: int, start: float = 500.0) -> None:
        self.servos = {number: Servo(start_counts=start, imperfections=CLEAN, key=(0, number)) for number in numbers}
        self.supply = Supply(key=(0,))
        self.adapter = self.adapter_type(self.servos, self.supply)

    def send(self, sent: str) -> str:
        return b"".join(reply.data for reply in self.adapter.receive(bytes.fromhex(sent), 0.0)).hex(" ")

    def wait(self, seconds: float) -> None:
        for unit in self.servos.values():
            unit.advance(seconds)

    def counts(self) -> list[int]:
        return [unit.counts for unit in self.servos.values()]


ASK_POS = "55 55 01 03 1c df"


def test_lx_examples() -> None:
    bus = _Bus(1)
    assert bus.send(ASK_POS) == "55 55 01 05 1c f4 01 e8"
    assert _Bus(1, start=-3.0).send(ASK_POS) == "55 55 01 05 1c fd ff e1"
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
    assert bus.send("55 55 01 07 01 f4 01 e8 03 16") == ""
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


class _Lsc(_Bus):
    """Servos behind a controller board."""

    adapter_type = LscAdapter


MOVE_1_TO_500 = "55 55 08 03 01 e8 03 01 f4 01"


def test_lsc_examples() -> None:
    board = _Lsc(1, 2, start=400.0)
    assert board.send(MOVE_1_TO_500) == ""
    board.wait(1.0)
    assert board.counts() == [500, 400]
    assert board.send("55 55 05 15 02 01 02") == "55 55 09 15 02 01 f4 01 02 90 01"
    assert board.send("55 55 05 15 02 01 09") == "55 55 06 15 01 01 f4 01"  # leaves out what is not there
    board.supply._volt = 7.5
    assert board.send("55 55 02 0f") == "55 55 04 0f 4c 1d"
    for sent, holds in ((MOVE_1_TO_500, True), ("55 55 09 14 06 01 02 03 04 05 06", False), (MOVE_1_TO_500, True)):
        board.send(sent)
        assert board.servos[1].holds == holds
