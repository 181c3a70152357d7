"""The controller board's protocol against frames written out by hand from the manual."""

import pytest

from rhizotwin.rig.arm.lsc_board import LscBoard
from rhizotwin.rig.errors import NoAnswerError, UnsafeError
from tests.rig.arm.fake_bus import SILENT, ScriptedLine, scripted

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
        LscBoard(ScriptedLine()).move({1: 500, 2: 1001}, 1.0)


def test_positions_signed_in_any_order_among_other_frames() -> None:
    for piece in (1, 1000):
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
        LscBoard(ScriptedLine(*[(ASK_12, BOTH_500), (ASK_12, FAR_OFF)] * 5)).positions([1, 2])


def test_what_arrived_before_the_question_is_no_answer() -> None:
    with scripted(LscBoard, (ASK_12, BOTH_500 + FAR_OFF), (ASK_12, BOTH_501), piece=11) as board:
        assert board.positions([1, 2]) == {1: 501, 2: 501}


NO_ANSWER = {
    "silent": (SILENT, "the board does not reply"),
    "one left out": ("55 55 06 15 01 01 f4 01", "no position for servo 2"),
    "one twice": ("55 55 09 15 02 01 f4 01 01 f4 01", "replies of the board are invalid"),
    "wrong number": ("55 55 09 15 03 01 f4 01 02 f4 01", "replies of the board are invalid"),
    "unasked only": (DONE, "replies of the board are invalid"),
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
    with pytest.raises(NoAnswerError, match="the board does not reply"):
        LscBoard(ScriptedLine(*[(ASK_VOLTS, SILENT), (REST, SILENT)] * 4)).voltage_v([1])
    with pytest.raises(NoAnswerError, match="repeated readings of the voltage differ"):
        LscBoard(ScriptedLine(*[(ASK_VOLTS, VOLTS_7_5), (ASK_VOLTS, "55 55 04 0f 4c 2d")] * 5)).voltage_v([1])


def test_torque_off_by_its_frame_and_on_by_a_move_in_place() -> None:
    with scripted(LscBoard, *[("55 55 09 14 06 01 02 03 04 05 06", SILENT)] * 2) as board:
        board.load([1, 2, 3, 4, 5, 6], False)
    with scripted(LscBoard, (ASK_12, BOTH_500), (ASK_12, BOTH_501), ("55 55 0b 03 02 e8 03 01 f5 01 02 f5 01", SILENT)) as board:
        board.load([1, 2], True)
    with pytest.raises(UnsafeError, match="position -3 of servo 2"):  # where it would jump
        LscBoard(ScriptedLine(*[(ASK_12, "55 55 09 15 02 01 f4 01 02 fd ff")] * 2)).load([1, 2], True)


def test_stop_holds_where_the_servos_are_despite_damage() -> None:
    on_its_way = ["55 55 09 15 02 01 f4 01 02 fd ff", "55 55 09 15 02 01 fe 03 02 fe ff", "55 55 09 15 02 01 08 02 02 fd ff"]
    there = ("55 55 0b 03 02 e8 03 01 08 02 02 00 00", SILENT)
    with scripted(LscBoard, *[(ASK_12, answer) for answer in on_its_way], there) as board:
        board.stop([1, 2])
