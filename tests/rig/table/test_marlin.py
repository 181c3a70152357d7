"""The link to a Marlin board: every fault that an answer can have."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import pytest

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.marlin_exchange import ANSWER_S, BUSY_S, LONGEST_S
from rhizotwin.rig.table.marlin_lines import POSITION
from tests.rig.table.marlin_script import GREETING, POSITION_LINE, Talk

M400 = "N8 M400"
NEXT = ("N9 M17", ("ok",))
ASKED = "N8 M114"
REFUSED = ("Error:checksum mismatch, Last Line: 7", "Resend: 8", "ok")
TWICE = ("Error:Line Number is not Last Line Number+1, Last Line: 8", "Resend: 9", "ok")


@dataclass(frozen=True)
class Trouble:
    """Answers to M400 as line 8, and how long they may keep the link."""

    name: str
    steps: tuple[tuple[str, tuple[Any, ...]], ...]
    least_s: float = 0.0
    most_s: float = 0.1


TROUBLES = (
    Trouble("none", ((M400, ("ok",)),)),
    Trouble("slow", ((M400, (9.0, "ok")),), 9.0, 9.0),
    Trouble("split", ((M400, (b"o", 0.1, b"k", 0.1, b"\r\n")),), 0.2, 0.3),
    Trouble("busy for long", ((M400, (*(2.0, "echo:busy: processing") * 20, 1.0, "ok")),), 41.0, 41.0),
    Trouble("damaged on its way", ((M400, REFUSED), (M400, ("ok",)))),
    Trouble("damaged ten times", (*((M400, REFUSED),) * 10, (M400, ("ok",)))),
    Trouble("no ok after the resend", ((M400, REFUSED[:2]), (M400, ("ok",))), 0.5, 0.6),
    Trouble("late ok after the resend", ((M400, (*REFUSED[:2], 0.4, "ok")), (M400, ("ok",))), 0.4, 0.5),
    Trouble("resend alone", ((M400, REFUSED[1:]), (M400, ("ok",)))),
    Trouble("resend lost", ((M400, (REFUSED[0], "ok")), (M400, ("ok",)))),
    Trouble("resend damaged", ((M400, (REFUSED[0], "Rezend: 8", "ok")), (M400, ("ok",)))),
    Trouble("error damaged", ((M400, ("Error:checksum mismatch, Last Lin", REFUSED[1], "ok")), (M400, ("ok",)))),
    Trouble("numbers contradict", ((M400, ("Error:x, Last Line: 7", "Resend: 1", "ok")), (M400, ("ok",)))),
    Trouble("numbers contradict each other as if it was taken", ((M400, ("Error:x, Last Line: 7", "Resend: 9", "ok")), (M400, ("ok",)))),
    Trouble("only a damaged error", ((M400, ("Error:checksum mi", "ok")), (M400, TWICE))),
    Trouble("ok lost", ((M400, ()), (M400, TWICE)), ANSWER_S, ANSWER_S + 0.1),
    Trouble("ok and the answer to its copy lost", ((M400, ()), (M400, ()), (M400, TWICE)), 13.0, 13.6),
    Trouble("ok lost and no ok after the resend", ((M400, ()), (M400, TWICE[:2])), 10.5, 10.6),
    Trouble("copies refused one by one", ((M400, ()), (M400, ()), (M400, (*TWICE, 0.2, *TWICE))), 13.2, 13.3),
    Trouble("ok damaged", ((M400, ("oj",)), (M400, TWICE)), 0.5, 0.6),
    Trouble("ok cut", ((M400, (b"o",)), (M400, TWICE)), ANSWER_S, ANSWER_S + 0.1),
    Trouble("ok without its end", ((M400, (b"ok",)), (M400, TWICE)), ANSWER_S, ANSWER_S + 0.1),
    Trouble("ok glued to a report", ((M400, ("T:20.00 /0.00ok",)), (M400, TWICE)), 0.5, 0.6),
    Trouble("line lost", ((M400, ()), (M400, ("ok",))), ANSWER_S, ANSWER_S + 0.6),
    Trouble("late beyond patience", ((M400, (11.0, "ok")), (M400, (1.5, *TWICE))), 11.0, 11.6),
    Trouble("idle board", ((M400, ("wait", 1.0, "wait")), (M400, TWICE)), 1.0, 1.1),
    Trouble("busy, then silence", ((M400, (2.0, "echo:busy: processing")), (M400, TWICE)), 2.0 + BUSY_S, 2.1 + BUSY_S),
    Trouble("with its number", ((M400, ("ok N8 P15 B3",)),)),
    Trouble("number of another line", ((M400, ("ok N7 P15 B3", 0.1, "ok N8 P15 B3")),), 0.1, 0.2),
    Trouble("chatter", ((M400, ("T:20.00 /0.00", "//action:prompt_end", "", "ok")),)),
    Trouble("unknown on its way", ((M400, ('echo:Unknown command: "^8 M400*47"', "ok")), (M400, ("ok",))), 0.0, 0.6),
)


@pytest.mark.parametrize("trouble", TROUBLES, ids=lambda trouble: trouble.name)
def test_a_command_gets_through(trouble: Trouble, talk: Talk) -> None:
    link = talk.then(*trouble.steps, NEXT)
    link.command("M400")
    assert trouble.least_s <= talk.since_s() <= trouble.most_s
    assert talk.script.steps == [NEXT]
    link.command("M17")
    assert not talk.script.steps


@pytest.mark.parametrize(
    "answers",
    [
        ("start",),
        (" Brown out Reset",),
        ("Marlin 2.1.2.5",),
        ("Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok"),
        ("Resend: 1",),
        ("Error:Line Number is not Last Line Number+1, Last Line: 0", "start"),
        ("ok", "Error:Printer halted. kill() called!"),
        ("Error:Printer halted. kill() called!",),
        ("Printer stopped due to errors. Fix the error and use M999 to restart.", "ok"),
    ],
    ids=lambda answers: answers[0],
)
def test_a_lost_board_stays_lost_until_it_is_started(answers: tuple[str, ...], talk: Talk) -> None:
    link = talk.then((M400, answers), ("N9 M17", ()))
    with suppress(LostError):
        link.command("M400")
    with pytest.raises(LostError, match="turntable on fake: the board"):
        link.command("M17")
    talk.script.steps.clear()
    assert not link.ready
    with pytest.raises(LostError):
        link.command("M17")
    talk.script.steps += GREETING
    link.start()
    assert link.ready
    assert link.sessions == 2


def test_a_lost_ok_and_a_silent_reset(talk: Talk) -> None:
    link = talk.then((M400, ()), (M400, ("Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok")))
    with pytest.raises(LostError, match=r"was reset \(it counts its lines from the beginning\)"):
        link.command("M400")


def test_a_reset_between_commands_is_seen_before_anything_is_sent(talk: Talk) -> None:
    talk.script.answer("ok", "start")
    with pytest.raises(LostError, match="was reset"):
        talk.link.command("M400")


def test_an_unplugged_board_is_lost(talk: Talk) -> None:
    def gone(_timeout_s: float) -> bytes:
        raise LostError("turntable on fake: unplugged")

    talk.script.read = gone
    with pytest.raises(LostError, match="unplugged"):
        talk.link.command("M400")
    assert not talk.link.ready


@dataclass(frozen=True)
class Hopeless:
    """Answers that never become an ok."""

    name: str
    steps: tuple[tuple[str, tuple[Any, ...]], ...]
    says: str
    most_s: float


@pytest.mark.parametrize(
    "case",
    [
        Hopeless("silence", ((M400, ()),) * 6, "did not answer after M400", 26.0),
        Hopeless("refused for ever", ((M400, REFUSED),) * 11, "refused it 10 times after M400", 6.0),
        Hopeless("busy for ever", ((M400, (2.0, "echo:busy: processing") * 200),), "busy without end after M400", LONGEST_S + 2.0),
        Hopeless("talks for ever", ((M400, ("echo:x",) * 3000),), "kept sending other things", 1.0),
        Hopeless("noise for ever", ((M400, (b"\xaa" * 4096,) * 20),), "sends without end", 1.0),
        Hopeless("errors for ever", ((M400, ("Error:x", "ok")),) * 6, "answered with errors after M400 .last heard: 'Error:x'.", 6.0),
        Hopeless("a number of another world", ((M400, ("Resend: 4711", "ok")),) * 11, "refused it 10 times", 6.0),
    ],
    ids=lambda case: case.name,
)
def test_what_never_ends_is_ended(case: Hopeless, talk: Talk) -> None:
    link = talk.then(*case.steps)
    with pytest.raises(NoAnswerError, match=case.says):
        link.command("M400")
    assert talk.since_s() <= case.most_s
    assert link.ready  # it was not reset: the link finds a new beginning
    talk.script.steps.clear()
    talk.script.waiting.clear()
    # Line 8 was never taken: the board wants it before line 9.
    wants = ("Error:Line Number is not Last Line Number+1, Last Line: 7", "Resend: 8", "ok")
    talk.then(("N9 M114", wants), (M400, ("ok",)), ("N9 M114", (POSITION_LINE, "ok")), ("N10 M17", ("ok",)))
    link.command("M17")
    assert not talk.script.steps


def test_unplugged_while_started(make_board: Any) -> None:
    board = make_board()
    board.unplugged = True
    with pytest.raises(OSError):  # a real port turns it into LostError
        MarlinLink(board).start()


def test_an_unknown_command_is_named(talk: Talk) -> None:
    link = talk.then(("N8 M150 S0", ('echo:Unknown command: "M150 S0"', "ok")), NEXT)
    with pytest.raises(RigError, match='the firmware does not know "M150 S0"') as caught:
        link.command("M150 S0")
    assert not isinstance(caught.value, LostError | NoAnswerError)
    link.command("M17")


def test_an_unknown_command_that_says_so_late_is_named(talk: Talk) -> None:
    """A doubled ``ok`` before it let the link go on."""
    link = talk.then(("N8 M150 S0", ("ok",)), ("N9 M114", ('echo:Unknown command: "M150 S0"', "ok", POSITION_LINE, "ok")))
    link.command("M150 S0")
    with pytest.raises(RigError, match='the firmware does not know "M150 S0"'):
        link.ask("M114", POSITION)


def test_an_unknown_command_may_be_allowed(talk: Talk) -> None:
    link = talk.then(("N8 M420 S0", ('echo:Unknown command: "M420 S0"', "ok")))
    link.command("M420 S0", optional=True)


def test_late_and_doubled_oks_are_dropped_before_sending(talk: Talk) -> None:
    link = talk.then((M400, ("ok", "ok", "ok", "wait")), ("N9 M17", (5.0, "ok")))
    link.command("M400")
    link.command("M17")
    assert talk.since_s() == 5.0


def test_an_answer_is_waited_for_behind_the_ok_of_an_earlier_command(talk: Talk) -> None:
    """The doubled ``ok`` of G1 passes for that of M400, whose own comes before the position."""
    moved = "X:9.00 Y:0.00 Z:0.00 E:0.00 Count X:160 Y:0 Z:0"
    link = talk.then((M400, (0.001, "ok")), ("N9 M114", (2.0, "echo:busy: processing", 1.5, "ok", moved, "ok")), ("N10 M17", ("ok",)))
    link.command("M400", expect_s=3.0)
    assert link.ask("M114", POSITION)[1] == "9.00"
    assert talk.since_s() == pytest.approx(3.501)
    link.command("M17")


def test_without_busy_lines_the_answer_is_waited_for_as_long_as_the_move_takes(talk: Talk) -> None:
    moved = "X:9.00 Y:0.00 Z:0.00 E:0.00 Count X:160 Y:0 Z:0"
    link = talk.then((M400, ("ok",)), ("N9 M114", ("ok", 7.0, "ok", moved, "ok")))
    link.command("M400", expect_s=8.0)
    assert link.ask("M114", POSITION, expect_s=8.0)[1] == "9.00"


def test_a_lost_position_is_asked_for_anew(talk: Talk) -> None:
    link = talk.then((ASKED, ("ok",)), ("N9 M114", ("X:0.0", "ok")), ("N10 M114", (POSITION_LINE, "ok")))
    assert link.ask("M114", POSITION)[1] == "0.00"


def test_a_position_without_its_ok_counts(talk: Talk) -> None:
    link = talk.then((ASKED, (POSITION_LINE,)), (ASKED, TWICE))
    assert link.ask("M114", POSITION)[1] == "0.00"


def test_a_refusal_that_was_overlooked_is_made_good(talk: Talk) -> None:
    """A doubled ``ok`` passed for that of line 8, whose refusal was lost: the board wants 8 before 9."""
    wants_8 = ("Error:Line Number is not Last Line Number+1, Last Line: 7", "Resend: 8", "ok")
    link = talk.then((M400, ("ok",)), ("N9 M17", wants_8), (M400, ("ok",)), NEXT)
    link.command("M400")
    link.command("M17")
    assert not talk.script.steps


def test_a_late_refusal_of_a_copy_does_no_harm(talk: Talk) -> None:
    """The refusal of the copy of line 8 comes when line 9 is in flight, and asks for 9."""
    link = talk.then((M400, (10.0, 0.5, "ok", 1.0, *TWICE)), (M400, ()), ("N9 M17", ("ok",)), ("N9 M17", ("ok",)), ("N10 M114", ()))
    link.command("M400")
    link.command("M17")
    assert talk.since_s() < 15.0


def test_after_ctrl_c_the_answers_still_to_come_are_waited_for(talk: Talk) -> None:
    link = talk.then((M400, (4.0, "ok")), ("N9 M114", ("ok", 4.0, POSITION_LINE, "ok")), ("N10 M17", ("ok",)))
    talk.script.interrupt = True
    with pytest.raises(KeyboardInterrupt):
        link.command("M400", expect_s=4.0)
    link.command("M17")
    assert not talk.script.steps
    assert talk.since_s() == pytest.approx(4.0)


def test_quick_stop_forgets_the_angle(make_board: Any) -> None:
    board = make_board(x_deg=360.0)
    link = MarlinLink(board)
    link.start()
    sessions = link.sessions
    link.command("G1 X720 F1800")
    assert link.quick_stop()
    assert board.x_deg == 0.0
    assert board.at_rest
    assert link.sessions == sessions + 1


def test_quick_stop_needs_the_emergency_parser(talk: Talk) -> None:
    talk.link.capabilities = frozenset()
    assert not talk.link.quick_stop()


def test_close_closes_the_port(talk: Talk) -> None:
    talk.link.close()
    assert talk.script.steps == [("closed", ())]
    with pytest.raises(LostError, match="closed"):
        talk.link.command("M400")
