"""The controller board's protocol against frames written out by hand from the manual."""

from collections.abc import Iterable
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.arm.lsc_board import LscBoard, find_frames, find_positions
from rhizotwin.rig.errors import NoAnswerError, UnsafeError

SILENT = ""
REST = "00 " * 100
ASK_12, BOTH_500 = "55 55 05 15 02 01 02", "55 55 09 15 02 01 f4 01 02 f4 01"
BOTH_501 = "55 55 09 15 02 01 f5 01 02 f5 01"
FAR_OFF = "55 55 09 15 02 01 f4 01 02 f4 03"
ONE_ONLY = "55 55 06 15 01 01 f4 01"
ASK_VOLTS, VOLTS_7_5 = "55 55 02 0f", "55 55 04 0f 4c 1d"
RAN, STOPPED, DONE = "55 55 05 06 01 01 00", "55 55 02 07", "55 55 05 08 01 01 00"


class _ScriptedLine:
    """A line that demands these writes in this order, and answers each with its bytes; time passes only in reads and sleeps."""

    def __init__(self, script: Iterable[tuple[str, str]], *, piece: int = 1000) -> None:
        self.script = [(bytes.fromhex(sent), bytes.fromhex(answer)) for sent, answer in script]
        self.clock = self
        self.closed = False
        self._piece = piece
        self._input = b""
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        self._now_s += seconds

    def write(self, data: bytes) -> None:
        sent, answer = self.script.pop(0)
        assert data.hex(" ") == sent.hex(" ")
        self._input += answer

    def read(self, timeout_s: float) -> bytes:
        assert timeout_s > 0.0
        chunk, self._input = self._input[: self._piece], self._input[self._piece :]
        self._now_s += 1e-3 if chunk else timeout_s
        return chunk

    def discard_input(self) -> None:
        self._input = b""

    def close(self) -> None:
        self.closed = True


def test_move_is_the_manuals_frame() -> None:
    line = _ScriptedLine([("55 55 08 03 01 e8 03 01 f4 01", SILENT)])
    LscBoard(line).move({1: 500}, 1.0)
    assert not line.script


def test_several_servos_go_into_one_frame() -> None:
    line = _ScriptedLine([("55 55 0b 03 02 30 75 06 00 00 05 e8 03", SILENT)])
    LscBoard(line).move({6: 0, 5: 1000}, 30.0)
    assert not line.script


@pytest.mark.parametrize(
    ("targets", "duration_s", "says"),
    [({1: 500, 2: 1001}, 1.0, "position 1001 of servo 2"), ({1: -1}, 1.0, "position -1"), ({1: 500}, 30.1, "outside 0 to 30 s")],
)
def test_nothing_is_sent_that_must_not_be(targets: dict[int, int], duration_s: float, says: str) -> None:
    with pytest.raises(UnsafeError, match=says):
        LscBoard(_ScriptedLine([])).move(targets, duration_s)


@dataclass(frozen=True)
class _Heard:
    name: str
    answer: str


@pytest.mark.parametrize("piece", [1, 1000], ids="pieces of {}".format)
@pytest.mark.parametrize(
    "case",
    [
        _Heard("clean", BOTH_500),
        _Heard("unasked frames around", DONE + BOTH_500 + STOPPED),
        _Heard("a run's echo before", RAN + BOTH_500),
        _Heard("garbage before", "00 55 55 ff 09 15" + BOTH_500),
        _Heard("echo before", ASK_12 + BOTH_500),
        _Heard("doubled", BOTH_500 + BOTH_500),
        _Heard("cut one before", "55 55 09 15 02 01 f4" + BOTH_500),
        _Heard("voltage before", VOLTS_7_5 + BOTH_500),
        _Heard("servos in another order", "55 55 09 15 02 02 f4 01 01 f4 01"),
    ],
    ids=lambda case: case.name,
)
def test_reads_positions_whatever_stands_around_them(case: _Heard, piece: int) -> None:
    line = _ScriptedLine([(ASK_12, case.answer)] * 2, piece=piece)
    assert LscBoard(line).positions([1, 2]) == {1: 500, 2: 500}
    assert not line.script


def test_positions_are_signed() -> None:
    line = _ScriptedLine([("55 55 04 15 01 05", "55 55 06 15 01 05 fd ff")] * 2)
    assert LscBoard(line).positions([5]) == {5: -3}


def test_a_slow_board_is_waited_for() -> None:
    class _Slow(_ScriptedLine):
        def read(self, timeout_s: float) -> bytes:
            if timeout_s < 0.45:
                return b""
            self.sleep(0.45)
            return super().read(timeout_s - 0.45)

    assert LscBoard(_Slow([(ASK_12, BOTH_500)] * 2)).positions([1, 2]) == {1: 500, 2: 500}


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ([FAR_OFF, BOTH_500, BOTH_500], 500),
        ([BOTH_500, FAR_OFF, BOTH_500, BOTH_501], 501),
        ([BOTH_500, BOTH_501], 501),
    ],
    ids=["damaged first", "damaged second", "a count of noise"],
)
def test_a_reading_counts_when_the_next_agrees(answers: list[str], expected: int) -> None:
    line = _ScriptedLine([(ASK_12, answer) for answer in answers])
    assert LscBoard(line).positions([1, 2]) == {1: expected, 2: expected}
    assert not line.script


def test_what_arrived_before_the_question_is_no_answer() -> None:
    line = _ScriptedLine([(ASK_12, BOTH_500 + FAR_OFF), (ASK_12, BOTH_501)], piece=11)
    assert LscBoard(line).positions([1, 2]) == {1: 501, 2: 501}


def test_readings_that_never_agree_are_refused() -> None:
    line = _ScriptedLine([(ASK_12, BOTH_500), (ASK_12, FAR_OFF)] * 5)
    with pytest.raises(NoAnswerError, match="no two readings of the positions agree"):
        LscBoard(line).positions([1, 2])


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (SILENT, "the board does not answer"),
        (ONE_ONLY, "no position for servo 2"),
        ("55 55 09 15 02 01 f4 01 03 f4 01", "no position for servo 2"),
        ("55 55 09 15 02 01 f4 01 01 f4 01", "cannot be understood"),
        ("55 55 09 15 03 01 f4 01 02 f4 01", "cannot be understood"),
        ("f0 0f f0 0f", "cannot be understood"),
        (DONE, "cannot be understood"),
        (BOTH_500[:-3], "cannot be understood"),
    ],
    ids=["silent", "one left out", "another instead", "one twice", "wrong number", "wrong baud rate", "unasked only", "cut"],
)
def test_what_is_no_answer_is_asked_for_again_and_then_named(answer: str, says: str) -> None:
    rest = [(REST, SILENT)] if answer == SILENT else []  # a board that waits for the rest of a damaged frame gets it
    line = _ScriptedLine([(ASK_12, answer), *rest, (ASK_12, BOTH_500), (ASK_12, BOTH_500)])
    assert LscBoard(line).positions([1, 2]) == {1: 500, 2: 500}
    line = _ScriptedLine([(ASK_12, answer), *rest] * 4)
    with pytest.raises(NoAnswerError, match=says):
        LscBoard(line).positions([1, 2])
    assert not line.script


def test_voltage() -> None:
    damaged = "55 55 04 0f 4c 3d"
    line = _ScriptedLine([(ASK_VOLTS, damaged), (ASK_VOLTS, DONE + VOLTS_7_5), (ASK_VOLTS, "55 55 04 0f 60 1d")])
    assert LscBoard(line).voltage_v([1, 2]) == pytest.approx(7.52)
    assert not line.script


def test_voltage_of_a_silent_board_and_an_unsteady_one() -> None:
    with pytest.raises(NoAnswerError, match="the board does not answer"):
        LscBoard(_ScriptedLine([(ASK_VOLTS, SILENT), (REST, SILENT)] * 4)).voltage_v([1])
    with pytest.raises(NoAnswerError, match="no two readings of the voltage agree"):
        LscBoard(_ScriptedLine([(ASK_VOLTS, VOLTS_7_5), (ASK_VOLTS, "55 55 04 0f 4c 2d")] * 5)).voltage_v([1])


def test_the_board_cannot_tell_torque_and_temperature() -> None:
    board = LscBoard(_ScriptedLine([]))
    assert board.loaded([1]) is None
    assert board.temperatures_c([1]) is None
    assert board.describe() == "LSC servo board"


def test_torque_goes_off_by_the_manuals_frame() -> None:
    line = _ScriptedLine([("55 55 09 14 06 01 02 03 04 05 06", SILENT)] * 2)
    LscBoard(line).load([1, 2, 3, 4, 5, 6], False)
    assert not line.script


def test_torque_comes_on_by_a_move_to_where_the_servos_are() -> None:
    line = _ScriptedLine([(ASK_12, BOTH_500), (ASK_12, BOTH_501), ("55 55 0b 03 02 e8 03 01 f5 01 02 f5 01", SILENT)])
    LscBoard(line).load([1, 2], True)
    assert not line.script


def test_torque_does_not_come_on_where_it_would_jump() -> None:
    outside = "55 55 09 15 02 01 f4 01 02 fd ff"
    with pytest.raises(UnsafeError, match="position -3 of servo 2"):
        LscBoard(_ScriptedLine([(ASK_12, outside)] * 2)).load([1, 2], True)


def test_stop_holds_where_the_servos_came_by_even_with_a_damaged_reading() -> None:
    on_its_way = ["55 55 09 15 02 01 f4 01 02 fd ff", "55 55 09 15 02 01 fe 03 02 fe ff", "55 55 09 15 02 01 08 02 02 fd ff"]
    line = _ScriptedLine([*[(ASK_12, answer) for answer in on_its_way], ("55 55 0b 03 02 e8 03 01 08 02 02 00 00", SILENT)])
    LscBoard(line).stop([1, 2])
    assert not line.script


def test_close_closes_the_line() -> None:
    line = _ScriptedLine([])
    LscBoard(line).close()
    assert line.closed


def by_hand(positions: dict[int, int]) -> bytes:
    """Return the answer about positions."""
    body = b"".join(bytes([servo, counts & 0xFF, counts >> 8 & 0xFF]) for servo, counts in positions.items())
    return bytes([0x55, 0x55, len(body) + 3, 0x15, len(positions)]) + body


RUBBISH = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([bytes.fromhex(RAN), bytes.fromhex(STOPPED), bytes.fromhex(DONE), bytes.fromhex(VOLTS_7_5), bytes.fromhex(ASK_12)]),
    st.lists(st.sampled_from([0x55, 0x09, 0x15, 0x02]), max_size=12).map(bytes),
    st.integers(0, 10).map(lambda size: bytes.fromhex(BOTH_500)[:size]),
)


@given(
    before=st.lists(RUBBISH, max_size=4),
    counts=st.lists(st.integers(-300, 1300), min_size=5, max_size=5),
    times=st.integers(1, 2),
    cut=st.integers(0, 19),
)
def test_finds_the_answer_in_any_rubbish(before: list[bytes], counts: list[int], times: int, cut: int) -> None:
    positions = dict(zip((6, 5, 4, 3, 2), counts, strict=True))
    answer = by_hand(positions)
    assert find_positions(b"".join(before) + answer * times + answer[:cut], (6, 5, 4, 3, 2)) == positions


@given(heard=st.binary(max_size=200))
def test_any_bytes_at_all_are_survived(heard: bytes) -> None:
    for params in find_frames(heard, 21):
        assert bytes([0x55, 0x55, len(params) + 2, 21]) + params in heard
    assert find_positions(heard, (1,)) is None or by_hand({1: 0})[:6] in heard
