"""Marlin's line protocol as the twin speaks it: lines, checksums and answers as in Marlin's own sources."""

import pytest

from rhizotwin.rig.twin.imperfections import CLEAN
from rhizotwin.rig.twin.lamps import Lamp
from rhizotwin.rig.twin.marlin_adapter import MarlinAdapter
from rhizotwin.rig.twin.stepper import Stepper


class _Board:
    """A board fed by hand, in its own time."""

    def __init__(self, *, ok_after_resend: bool = True) -> None:
        self.table = Stepper(full_step_deg=1.8, imperfections=CLEAN, key=(0,))
        self.lamps = tuple(Lamp(full_rgb=(255, 255, 255), imperfections=CLEAN, key=(i,)) for i in (0, 1))
        self.adapter = MarlinAdapter(self.table, (self.lamps[0], self.lamps[1]), ok_after_resend=ok_after_resend)
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
    for line in ("N6 M150 S0 R255 U255 B255 P255*119", "N7 M150 S1 I0 R255*123", "N8 M18 S0*81"):
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
    board = _Board()
    answers = [board.send(f"G1 X{(k % 2) * 10} F600") for k in range(1, 20)]
    assert (answers[:16], answers[-1]) == ([["ok"]] * 16, [])  # a full queue


def test_an_idle_motor_is_released_unless_it_was_forbidden() -> None:
    board = _Board()
    for line, seconds, energised in (("M17", 119.0, True), ("M115", 2.0, False), ("M18 S0", 0.0, False), ("M17", 100_000.0, True)):
        board.send(line)
        board.wait(seconds)
        assert board.table.energised == energised


def test_m410_stops_at_once_even_behind_m400() -> None:
    board = _Board()
    board.send("G1 X90 F600")
    board.send("M400")
    board.wait(1.5)
    assert board.send("M410") == ["ok", "ok"]
    assert 5.0 < board.table.true_deg < 20.0
    assert f"X:{board.table.true_deg:.2f} " in board.send("M114")[0]


def test_a_reset_forgets_everything_and_greets() -> None:
    board = _Board()
    for line in ("N1 M115*39", "G92 X370", "M150 R U B", "M17"):
        board.send(line)
    board.adapter.reset(board.now_s, reason="Watchdog Reset")
    assert board.send("M114") == []  # lost: it is starting
    assert board.wait(1.0)[:3] == ["start", " Watchdog Reset", "Marlin 2.1.2.5"]
    assert board.send("M114")[0].startswith("X:0.00 ")
    assert board.send("N1 M115*39")[-1] == "ok"
    assert (board.table.energised, board.lamps[0].level) == (False, 0.0)
