"""The two servo protocols against frames written out by hand from the manuals."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rhizotwin.rig.arm.lsc_board import LscBoard
from rhizotwin.rig.arm.lx_bus import LxBus, find_reply
from rhizotwin.rig.arm.servo_bus import check_move
from rhizotwin.rig.errors import NoAnswerError, UnsafeError
from tests.rig.fake_time import Time

SILENT = ""


class _Line:
    """A line that demands these writes in this order, and answers each with its bytes; time passes only in reads and sleeps."""

    def __init__(self, *script: tuple[str, str], echo: bool = False, piece: int = 1000) -> None:
        self.script = [(bytes.fromhex(sent), bytes.fromhex(answer)) for sent, answer in script]
        self.clock = Time()
        self._echo = echo
        self._piece = piece
        self._input = b""

    def write(self, data: bytes) -> None:
        sent, answer = self.script.pop(0)
        assert data.hex(" ") == sent.hex(" ")
        self._input += (data if self._echo else b"") + answer

    def read(self, timeout_s: float) -> bytes:
        assert timeout_s > 0.0
        chunk, self._input = self._input[: self._piece], self._input[self._piece :]
        self.clock.sleep(1e-4 if chunk else timeout_s)
        return chunk

    def discard_input(self) -> None:
        self._input = b""


@contextmanager
def scripted(bus: Callable[[_Line], Any], *script: tuple[str, str], echo: bool = False, piece: int = 1000) -> Iterator[Any]:
    """Give a bus on a scripted line, all of which must be used."""
    line = _Line(*script, echo=echo, piece=piece)
    yield bus(line)
    assert not line.script


REST = "00 " * 100
ASK_12, BOTH_500 = "55 55 05 15 02 01 02", "55 55 09 15 02 01 f4 01 02 f4 01"
BOTH_501 = "55 55 09 15 02 01 f5 01 02 f5 01"
FAR_OFF = "55 55 09 15 02 01 f4 01 02 f4 03"
ASK_VOLTS, VOLTS_7_5 = "55 55 02 0f", "55 55 04 0f 4c 1d"
RAN, STOPPED, DONE = "55 55 05 06 01 01 00", "55 55 02 07", "55 55 05 08 01 01 00"


def test_a_move_is_one_frame() -> None:
    with scripted(LscBoard, ("55 55 08 03 01 e8 03 01 f4 01", SILENT)) as board:
        board.move({1: 500}, 1.0)
    with scripted(LscBoard, ("55 55 0b 03 02 30 75 06 00 00 05 e8 03", SILENT)) as board:
        board.move({6: 0, 5: 1000}, 30.0)
    with pytest.raises(UnsafeError, match="position 1001 of servo 2"):
        LscBoard(_Line()).move({1: 500, 2: 1001}, 1.0)


@pytest.mark.parametrize("piece", [1, 1000])
def test_positions_signed_in_any_order_among_other_frames(piece: int) -> None:
    with scripted(LscBoard, *[("55 55 04 15 01 05", "55 55 06 15 01 05 fd ff")] * 2, piece=piece) as board:
        assert board.positions([5]) == {5: -3}
    heard = DONE + "55 55 09 15 02 02 f4 01 01 f4 01" + STOPPED
    with scripted(LscBoard, *[(ASK_12, heard)] * 2, piece=piece) as board:
        assert board.positions([1, 2]) == {1: 500, 2: 500}


@pytest.mark.parametrize(("answers", "expected"), [([FAR_OFF, BOTH_500, BOTH_500], 500), ([BOTH_500, BOTH_501], 501)])
def test_a_reading_counts_when_the_next_agrees(answers: list[str], expected: int) -> None:
    with scripted(LscBoard, *[(ASK_12, answer) for answer in answers]) as board:
        assert board.positions([1, 2]) == {1: expected, 2: expected}
    with pytest.raises(NoAnswerError, match="repeated readings of the positions differ"):
        LscBoard(_Line(*[(ASK_12, BOTH_500), (ASK_12, FAR_OFF)] * 5)).positions([1, 2])


def test_what_arrived_before_the_question_is_no_answer() -> None:
    with scripted(LscBoard, (ASK_12, BOTH_500 + FAR_OFF), (ASK_12, BOTH_501), piece=11) as board:
        assert board.positions([1, 2]) == {1: 501, 2: 501}


NO_ANSWER = {
    "silent": (SILENT, "the board does not reply"),
    "one left out": ("55 55 06 15 01 01 f4 01", "no position for servo 2"),
    "cut": (BOTH_500[:-3], "replies of the board are invalid"),
}


@pytest.mark.parametrize(("answer", "says"), NO_ANSWER.values(), ids=NO_ANSWER)
def test_what_is_no_answer_is_asked_for_again_and_then_named(answer: str, says: str) -> None:
    rest = [(REST, SILENT)] if answer == SILENT else []  # a board that waits for the rest of a damaged frame gets it
    with scripted(LscBoard, (ASK_12, answer), *rest, (ASK_12, BOTH_500), (ASK_12, BOTH_500)) as board:
        assert board.positions([1, 2]) == {1: 500, 2: 500}
    with scripted(LscBoard, *[(ASK_12, answer), *rest] * 4) as board, pytest.raises(NoAnswerError, match=says):
        board.positions([1, 2])


def test_voltage() -> None:
    damaged = "55 55 04 0f 4c 3d"
    with scripted(LscBoard, (ASK_VOLTS, damaged), (ASK_VOLTS, DONE + VOLTS_7_5), (ASK_VOLTS, "55 55 04 0f 60 1d")) as board:
        assert board.voltage_v([1, 2]) == pytest.approx(7.52)


def test_torque_off_by_its_frame_and_on_by_a_move_in_place() -> None:
    with scripted(LscBoard, *[("55 55 09 14 06 01 02 03 04 05 06", SILENT)] * 2) as board:
        board.load([1, 2, 3, 4, 5, 6], False)
    with scripted(LscBoard, (ASK_12, BOTH_500), (ASK_12, BOTH_501), ("55 55 0b 03 02 e8 03 01 f5 01 02 f5 01", SILENT)) as board:
        board.load([1, 2], True)
    with pytest.raises(UnsafeError, match="position -3 of servo 2"):  # where it would jump
        LscBoard(_Line(*[(ASK_12, "55 55 09 15 02 01 f4 01 02 fd ff")] * 2)).load([1, 2], True)


def test_stop_holds_where_the_servos_are_despite_damage() -> None:
    on_its_way = ["55 55 09 15 02 01 f4 01 02 fd ff", "55 55 09 15 02 01 fe 03 02 fe ff", "55 55 09 15 02 01 08 02 02 fd ff"]
    there = ("55 55 0b 03 02 e8 03 01 08 02 02 00 00", SILENT)
    with scripted(LscBoard, *[(ASK_12, answer) for answer in on_its_way], there) as board:
        board.stop([1, 2])


ASK_POS_1, POS_1_IS_500 = "55 55 01 03 1c df", "55 55 01 05 1c f4 01 e8"
POS_1_IS_MINUS_3 = "55 55 01 05 1c fd ff e1"
ASK_POS_2, POS_2_IS_500 = "55 55 02 03 1c de", "55 55 02 05 1c f4 01 e7"
ASK_LOAD_1, LOAD_1_ON, LOAD_1_OFF = "55 55 01 03 20 db", "55 55 01 04 20 01 d9", "55 55 01 04 20 00 da"
ASK_LOAD_2, LOAD_2_OFF = "55 55 02 03 20 da", "55 55 02 04 20 00 d9"
# Servo 1 to 500, servo 2 to 600, in 1000 ms.
WAIT_1, ASK_WAIT_1, WAIT_1_IS = "55 55 01 07 07 f4 01 e8 03 10", "55 55 01 03 08 f3", "55 55 01 07 08 f4 01 e8 03 0f"
WAIT_2, ASK_WAIT_2, WAIT_2_IS = "55 55 02 07 07 58 02 e8 03 aa", "55 55 02 03 08 f2", "55 55 02 07 08 58 02 e8 03 a9"
START_ALL, START_2 = "55 55 fe 03 0b f3", "55 55 02 03 0b ef"
ASK_MOVE_1, MOVE_1_IS, MOVE_1_IS_NOT = "55 55 01 03 02 f9", "55 55 01 07 02 f4 01 e8 03 15", "55 55 01 07 02 00 00 00 00 f5"
ASK_MOVE_2, MOVE_2_IS, MOVE_2_IS_NOT = "55 55 02 03 02 f8", "55 55 02 07 02 58 02 e8 03 af", "55 55 02 07 02 00 00 00 00 f4"
ARMED = [(WAIT_1, SILENT), (ASK_WAIT_1, WAIT_1_IS), (WAIT_2, SILENT), (ASK_WAIT_2, WAIT_2_IS)]
STARTED = [(START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS), (ASK_MOVE_2, MOVE_2_IS)]
TO_500_AND_600 = {1: 500, 2: 600}


USELESS = {
    "silence": SILENT,
    "echo only": ASK_POS_1,
    "damaged": "55 55 01 05 1c f4 02 e8",
    "another servo": POS_2_IS_500,
}


@pytest.mark.parametrize("heard", USELESS.values(), ids=USELESS)
def test_asks_again_and_then_gives_up(heard: str) -> None:
    with scripted(LxBus, (ASK_POS_1, heard), (ASK_POS_1, POS_1_IS_500)) as bus:
        assert bus.positions([1]) == {1: 500}
    line = _Line(*[(ASK_POS_1, heard)] * 5)
    with pytest.raises(NoAnswerError, match="servo 1 does not reply"):
        LxBus(line).positions([1])
    assert not line.script
    assert line.clock.at_s < 1.1


def test_readings() -> None:
    with scripted(LxBus, (ASK_POS_1, POS_1_IS_500 * 2), (ASK_POS_1, POS_1_IS_MINUS_3), piece=8) as bus:
        assert [bus.positions([1]) for _ in range(2)] == [{1: 500}, {1: -3}]  # what arrived before the question is no answer
    with scripted(LxBus, (ASK_POS_2, POS_2_IS_500), (ASK_POS_1, POS_1_IS_MINUS_3), piece=1) as bus:
        assert bus.positions([2, 1]) == {2: 500, 1: -3}
    with scripted(LxBus, ("55 55 01 03 1b e0", "55 55 01 05 1b e8 1c da"), ("55 55 02 03 1b df", "55 55 02 05 1b 1c 1b a6")) as bus:
        assert bus.voltage_v([1, 2]) == pytest.approx(6.94)  # the lowest
    with scripted(LxBus, ("55 55 01 03 1a e1", "55 55 01 04 1a 1f c1"), ("55 55 02 03 1a e0", "55 55 02 04 1a 29 b6")) as bus:
        assert bus.temperatures_c([1, 2]) == {1: 31, 2: 41}
    with scripted(LxBus, (ASK_LOAD_1, LOAD_1_ON), (ASK_LOAD_2, LOAD_2_OFF)) as bus:
        assert bus.loaded([1, 2]) == {1: True, 2: False}


@pytest.mark.parametrize("echo", [True, False], ids=["echo", "no echo"])
def test_a_move_waits_everywhere_and_starts_at_once(echo: bool) -> None:
    with scripted(LxBus, *ARMED, *STARTED, echo=echo) as bus:
        bus.move(TO_500_AND_600, 1.0)
    # One servo is started by its number, so that no target of a failed move starts.
    with scripted(LxBus, *ARMED[2:], (START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS), echo=echo) as bus:
        bus.move({2: 600}, 1.0)


def test_a_target_not_taken_is_sent_again_before_a_move() -> None:
    with scripted(LxBus, (WAIT_1, SILENT), (ASK_WAIT_1, "55 55 01 07 08 f3 01 e8 03 10"), *ARMED, *STARTED) as bus:
        bus.move(TO_500_AND_600, 1.0)
    with (
        scripted(LxBus, *ARMED[:2], *[(WAIT_2, SILENT), (ASK_WAIT_2, "55 55 02 07 08 00 00 00 00 ee")] * 4) as bus,
        pytest.raises(NoAnswerError, match="servo 2 replies but does not accept commands"),
    ):
        bus.move(TO_500_AND_600, 1.0)


def test_a_servo_that_missed_the_start_is_started_by_number() -> None:
    missed = [(START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS), (ASK_MOVE_2, MOVE_2_IS_NOT)]
    with scripted(LxBus, *ARMED, *missed, (START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS)) as bus:
        bus.move(TO_500_AND_600, 1.0)
    with (
        scripted(LxBus, *ARMED, *missed, *[(START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS_NOT)] * 3) as bus,
        pytest.raises(NoAnswerError, match="servo 2 did not start"),
    ):
        bus.move(TO_500_AND_600, 1.0)


def test_servos_that_never_report_a_start_are_left_alone() -> None:
    not_started = [(ASK_MOVE_1, MOVE_1_IS_NOT), (ASK_MOVE_2, MOVE_2_IS_NOT)]
    one_by_one = [("55 55 01 03 0b f0", SILENT), (START_2, SILENT), *not_started]
    with scripted(LxBus, *ARMED, (START_ALL, SILENT), *not_started, *one_by_one * 3) as bus:
        bus.move(TO_500_AND_600, 1.0)


FORBIDDEN = [
    ({1: 500, 2: 1001}, 1.0, "position 1001 of servo 2"),
    ({1: 500}, float("nan"), "outside 0 to 30 s"),
    ({254: 500}, 1.0, "servo number 254"),
]


@pytest.mark.parametrize(("targets", "duration_s", "says"), FORBIDDEN)
def test_nothing_is_sent_that_must_not_be(targets: dict[int, int], duration_s: float, says: str) -> None:
    with pytest.raises(UnsafeError, match=says):
        LxBus(_Line()).move(targets, duration_s)
    check_move({0: 0, 253: 1000}, 30.0)


def test_torque_is_switched_until_it_reads_so_of_each_servo() -> None:
    on, off = "55 55 01 04 1f 01 da", "55 55 01 04 1f 00 db"
    with scripted(LxBus, (on, SILENT), (ASK_LOAD_1, LOAD_1_OFF), (on, SILENT), (ASK_LOAD_1, LOAD_1_ON)) as bus:
        bus.load([1], True)
    silent = [(off, SILENT), *[(ASK_LOAD_1, SILENT)] * 5]
    with (
        scripted(LxBus, *silent, ("55 55 02 04 1f 00 da", SILENT), (ASK_LOAD_2, LOAD_2_OFF)) as bus,
        pytest.raises(NoAnswerError, match="servo 1"),
    ):
        bus.load([1, 2], False)


def test_stop_asks_nothing() -> None:
    with scripted(LxBus, *[("55 55 01 03 0c ef", SILENT), ("55 55 02 03 0c ee", SILENT)] * 2) as bus:
        bus.stop([1, 2])


def test_silence_of_the_adapter_or_of_a_servo() -> None:
    silence = [(ASK_POS_1, SILENT)] * 5
    with pytest.raises(NoAnswerError, match="the adapter sends no echo"):
        LxBus(_Line(*silence), echo="yes").positions([1])
    for bus in (LxBus(_Line(*silence, echo=True), echo="yes"), LxBus(_Line(*silence), echo="no")):
        with pytest.raises(NoAnswerError, match="check the servos' supply"):
            bus.positions([1])


def test_never_believes_a_damaged_answer() -> None:
    whole = bytes.fromhex(POS_1_IS_500)
    assert find_reply(whole, 1, 28, 2) == whole[5:7]
    for echo in (b"", bytes.fromhex(ASK_POS_1)):
        damaged = [echo + whole[:at] + bytes([whole[at] ^ flip]) + whole[at + 1 :] for at in range(8) for flip in range(1, 256)]
        assert [heard for heard in damaged if find_reply(heard, 1, 28, 2) is not None] == []
