"""The two servo protocols as the twin speaks them; frames byte by byte from the vendors' manuals."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.twin.imperfections import CLEAN
from rhizotwin.rig.twin.lsc_adapter import LscAdapter
from rhizotwin.rig.twin.lx_adapter import LxAdapter
from rhizotwin.rig.twin.servo import Servo, Supply


def hexes(text: str) -> bytes:
    return bytes.fromhex(text)


def servos(*numbers: int, start: float = 500.0) -> dict[int, Servo]:
    return {number: Servo(start_counts=start, imperfections=CLEAN, key=(0, number)) for number in numbers}


class _Bus:
    """Servos on a bus, fed by hand."""

    def __init__(self, *numbers: int, start: float = 500.0) -> None:
        self.servos = servos(*numbers, start=start)
        self.supply = Supply(key=(0,))
        self.adapter = LxAdapter(self.servos, self.supply)

    def send(self, data: bytes) -> bytes:
        return b"".join(reply.data for reply in self.adapter.receive(data, 0.0))

    def wait(self, seconds: float) -> None:
        for unit in self.servos.values():
            unit.advance(seconds)


def test_lx_examples() -> None:
    bus = _Bus(1)
    assert bus.send(hexes("55 55 01 03 1c df")) == hexes("55 55 01 05 1c f4 01 e8")
    bus.servos[1] = servos(1, start=-3.0)[1]
    assert bus.send(hexes("55 55 01 03 1c df")) == hexes("55 55 01 05 1c fd ff e1")
    assert bus.send(hexes("55 55 fe 03 0e f0")) == hexes("55 55 01 04 0e 01 eb")
    bus.servos[1].heat(31.0)
    assert bus.send(hexes("55 55 01 03 1a e1")) == hexes("55 55 01 04 1a 1f c1")
    bus.supply._volt = 7.4
    assert bus.send(hexes("55 55 01 03 1b e0")) == hexes("55 55 01 05 1b e8 1c da")


def test_lx_moves_at_once() -> None:
    bus = _Bus(1, start=400.0)
    assert bus.send(hexes("55 55 01 07 01 f4 01 e8 03 16")) == b""
    bus.wait(0.5)
    assert bus.servos[1].counts == 450
    bus.wait(0.5)
    assert bus.servos[1].counts == 500
    assert bus.send(hexes("55 55 01 03 02 f9")) == hexes("55 55 01 07 02 f4 01 e8 03 15")


def test_lx_waits_for_the_common_start() -> None:
    bus = _Bus(1, 2, start=400.0)
    for number, checksum in ((1, "10"), (2, "0f")):
        bus.send(hexes(f"55 55 0{number} 07 07 f4 01 e8 03 {checksum}"))
    bus.wait(2.0)
    assert [unit.counts for unit in bus.servos.values()] == [400, 400]
    assert bus.send(hexes("55 55 01 03 08 f3")) == hexes("55 55 01 07 08 f4 01 e8 03 0f")
    assert bus.send(hexes("55 55 fe 03 0b f3")) == b""
    bus.wait(1.0)
    assert [unit.counts for unit in bus.servos.values()] == [500, 500]


def test_lx_stops_where_it_is() -> None:
    bus = _Bus(1, start=400.0)
    bus.send(hexes("55 55 01 07 01 f4 01 e8 03 16"))
    bus.wait(0.25)
    bus.send(hexes("55 55 01 03 0c ef"))
    bus.wait(5.0)
    assert bus.servos[1].counts == 425


def test_lx_torque() -> None:
    bus = _Bus(1)
    assert bus.send(hexes("55 55 01 03 20 db")) == hexes("55 55 01 04 20 00 da")
    bus.send(hexes("55 55 01 04 1f 01 da"))
    assert bus.send(hexes("55 55 01 03 20 db")) == hexes("55 55 01 04 20 01 d9")
    bus.send(hexes("55 55 01 04 1f 00 db"))
    assert not bus.servos[1].holds


def test_lx_limits_are_kept_and_clamp() -> None:
    bus = _Bus(1)
    assert bus.send(hexes("55 55 01 03 15 e6")) == hexes("55 55 01 07 15 00 00 e8 03 f7")
    bus.send(hexes("55 55 01 07 14 64 00 84 03 f8"))
    bus.send(hexes("55 55 01 07 01 e8 03 00 00 0b"))
    bus.wait(2.0)
    assert bus.servos[1].counts == 900
    assert bus.send(hexes("55 55 01 03 17 e4")) == hexes("55 55 01 07 17 64 19 e0 2e 55")
    assert bus.send(hexes("55 55 01 03 19 e2")) == hexes("55 55 01 04 19 55 8c")


def test_lx_renames_a_servo() -> None:
    bus = _Bus(1)
    bus.send(hexes("55 55 01 04 0d 09 e4"))
    assert set(bus.servos) == {9}


@pytest.mark.parametrize(
    "bad", ["55 55 01 03 1c de", "55 55 02 03 1c de", "55 54 01 03 1c df", "55 55 01 02 1c e0", "55 55 01 04 1c 00 de", "55 55 fe 03 1c e2"]
)
def test_lx_ignores_what_is_not_for_it(bad: str) -> None:
    bus = _Bus(1)
    assert bus.send(hexes(bad)) == b""
    assert bus.send(hexes("00 00 00 00 00 00 00 55 55 01 03 1c df")) == hexes("55 55 01 05 1c f4 01 e8")


def test_lx_answers_collide_on_a_broadcast() -> None:
    heard = _Bus(1, 2).send(hexes("55 55 fe 03 0e f0"))
    assert heard == hexes("55 55 00 04 0e 00 e9")


def test_lx_frames_come_in_pieces_and_after_noise() -> None:
    bus = _Bus(1)
    answers = b""
    for byte in hexes("ff 55 13 55 55 55 01 03 1c df"):
        answers += bus.send(bytes([byte]))
    assert answers == hexes("55 55 01 05 1c f4 01 e8")


def test_lx_is_dumb_without_power() -> None:
    bus = _Bus(1)
    bus.supply.brown_out(0.5)
    assert bus.send(hexes("55 55 01 03 1c df")) == b""
    bus.supply.advance(0.6)
    assert bus.send(hexes("55 55 01 03 1c df")) == hexes("55 55 01 05 1c f4 01 e8")


@given(st.binary(max_size=200))
def test_lx_survives_noise(noise: bytes) -> None:
    bus = _Bus(1)
    bus.send(noise + b"\x00" * 16)
    answers = bus.send(hexes("55 55 01 03 1b e0"))
    assert answers.startswith(b"\x55\x55")


class _Board(_Bus):
    """Servos behind a controller board."""

    def __init__(self, *numbers: int, start: float = 500.0) -> None:
        super().__init__(*numbers, start=start)
        self.adapter = LscAdapter(self.servos, self.supply)


def test_lsc_examples() -> None:
    board = _Board(1, 2, start=400.0)
    assert board.send(hexes("55 55 08 03 01 e8 03 01 f4 01")) == b""
    board.wait(1.0)
    assert [unit.counts for unit in board.servos.values()] == [500, 400]
    board.servos[2] = servos(2)[2]
    assert board.send(hexes("55 55 05 15 02 01 02")) == hexes("55 55 09 15 02 01 f4 01 02 f4 01")
    board.supply._volt = 7.5
    assert board.send(hexes("55 55 02 0f")) == hexes("55 55 04 0f 4c 1d")


def test_lsc_unloads_and_a_move_loads_again() -> None:
    board = _Board(1, 2, 3, 4, 5, 6)
    board.send(hexes("55 55 08 03 01 e8 03 01 f4 01"))
    assert board.servos[1].holds
    board.send(hexes("55 55 09 14 06 01 02 03 04 05 06"))
    assert not board.servos[1].holds
    board.send(hexes("55 55 08 03 01 e8 03 01 f4 01"))
    assert board.servos[1].holds


def test_lsc_leaves_out_servos_that_are_not_there() -> None:
    assert _Board(1).send(hexes("55 55 05 15 02 01 09")) == hexes("55 55 06 15 01 01 f4 01")


def test_lsc_tells_negative_positions_as_two_bytes() -> None:
    assert _Board(1, start=-2.0).send(hexes("55 55 04 15 01 01")) == hexes("55 55 06 15 01 01 fe ff")


def test_lsc_runs_no_group_but_says_so_and_then_complete() -> None:
    replies = _Board(1).adapter.receive(hexes("55 55 05 06 08 01 00"), 2.0)
    assert [reply.data for reply in replies] == [hexes("55 55 05 06 08 01 00"), hexes("55 55 05 08 08 01 00")]
    assert replies[1].due_s > replies[0].due_s


def test_lsc_ignores_frames_of_another_length() -> None:
    board = _Board(1)
    assert board.send(hexes("55 55 04 15 06 01")) == b""
    assert board.send(hexes("55 55 05 03 01 e8 03")) == b""
    assert board.servos[1].command == (500, 0)
