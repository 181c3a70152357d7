"""The link to a Marlin board: the bytes on the wire, every fault that an answer can have, and random pairs of them."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import LostError, NoAnswerError, RigError
from rig.marlin import MarlinLink
from rig.marlin_exchange import ANSWER_S, BUSY_S, LONGEST_S
from rig.marlin_lines import CAPABILITY, FIRMWARE, POSITION, Kind, numbered, read_line
from rig.rig_file import TurntablePart
from rig.turntable import MarlinTurntable

POSITION_LINE = "X:0.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0"
GREETING: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("N0 M110 N0", ("ok",)),
    ("N1 M115", ("FIRMWARE_NAME:Marlin 2.1.3 (Oct 23 2023 10:00:00) SOURCE_CODE_URL:x", "Cap:EMERGENCY_PARSER:1", "ok")),
    ("N2 M113 S2", ("ok",)),
    ("N3 M155 S0", ('echo:Unknown command: "M155 S0"', "ok")),
    ("N4 M154 S0", ('echo:Unknown command: "M154 S0"', "ok")),
    ("N5 M211 S0", ("echo:Soft endstops: Off  Min:  X0.00   Max:  X200.00", "ok")),
    ("N6 M18 S0", ("ok",)),
    ("N7 M114", (POSITION_LINE, "ok")),
)
"""The lines without their checksums, which the script adds by itself."""


class Script:
    """A port that demands lines in their order and answers each; an answer with a number is that many seconds late."""

    url = "fake"
    device = "turntable"

    def __init__(self, clock: Any, *steps: tuple[str, tuple[Any, ...]]) -> None:
        self.clock = clock
        self.steps = list(steps)
        self.waiting: list[tuple[float, bytes]] = []
        self.interrupt = False

    def answer(self, *answers: Any) -> None:
        """Let the board say something."""
        due_s = self.clock.now_s()
        for answer in answers:
            if isinstance(answer, float):
                due_s += answer
            else:
                self.waiting.append((due_s, answer if isinstance(answer, bytes) else f"{answer}\n".encode()))

    def write(self, data: bytes) -> None:
        """Demand the next line of the script."""
        assert self.steps, f"nothing more was to be sent, but {data!r} was"
        wanted, answers = self.steps.pop(0)
        checksum = 0
        for byte in wanted.encode():
            checksum ^= byte
        assert data == f"{wanted}*{checksum}\n".encode()
        self.answer(*answers)

    def read(self, timeout_s: float) -> bytes:
        """Hand out the next answer that is due within the time-out."""
        if self.interrupt and timeout_s > 0.0:
            self.interrupt = False
            raise KeyboardInterrupt
        until_s = self.clock.now_s() + timeout_s
        if not self.waiting or self.waiting[0][0] > until_s:
            self.clock.sleep(timeout_s)
            return b""
        due_s, data = self.waiting.pop(0)
        self.clock.sleep(due_s - self.clock.now_s())
        return data

    def discard_input(self) -> None:
        """Refuse: what is dropped must have been read."""
        raise AssertionError("the link reads what it drops")

    def close(self) -> None:
        """Note it."""
        self.steps.append(("closed", ()))


@dataclass
class Talk:
    """A link that was started on a script, which goes on with line 8."""

    script: Script
    link: MarlinLink

    def then(self, *steps: tuple[str, tuple[Any, ...]]) -> MarlinLink:
        """Go on with the script; return the link."""
        self.script.steps += steps
        return self.link

    def since_s(self) -> float:
        """Return the time since the link was started."""
        return self.script.clock.now_s()


@pytest.fixture
def talk(make_board: Any) -> Talk:
    script = Script(make_board().clock, *GREETING)
    link = MarlinLink(script)
    link.start()
    assert not script.steps
    script.clock.at_s = 0.0
    return Talk(script, link)


@pytest.mark.parametrize(
    ("number", "text", "sent"),
    [
        (0, "M110 N0", b"N0 M110 N0*125\n"),
        (1, "M115", b"N1 M115*39\n"),
        (2, "G91", b"N2 G91*19\n"),
        (3, "G1 X3.6 F1800", b"N3 G1 X3.6 F1800*23\n"),
        (4, "M400", b"N4 M400*35\n"),
        (5, "M114", b"N5 M114*34\n"),
        (6, "M150 S0 R255 U255 B255 P255", b"N6 M150 S0 R255 U255 B255 P255*119\n"),
        (7, "M150 S1 I0 R255", b"N7 M150 S1 I0 R255*123\n"),
        (8, "M18 S0", b"N8 M18 S0*81\n"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_lines_have_number_and_checksum(number: int, text: str, sent: bytes) -> None:
    assert numbered(number, text) == sent


@pytest.mark.parametrize("text", ["G1 X1;", "M117 *", "G1\nG1", "M117 é", "M117 " + "x" * 90])
def test_what_no_line_can_carry_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        numbered(1, text)


@pytest.mark.parametrize(
    ("raw", "kind", "number"),
    [
        (b"ok", Kind.OK, None),
        (b"ok\r", Kind.OK, None),
        (b"ok N7 P15 B3", Kind.OK, 7),
        (b"ok T:20.0 /0.0", Kind.OK, None),
        (b"\xff\x00ok", Kind.OK, None),
        (b"okay", Kind.LIKE_OK, None),
        (b"T:20ok", Kind.LIKE_OK, None),
        (b"o\xebk", Kind.LIKE_OK, None),
        (b"n", Kind.LIKE_OK, None),
        (b"echo:busy: processing", Kind.BUSY, None),
        (b"busy: paused for user", Kind.BUSY, None),
        (b"wait", Kind.WAIT, None),
        (b"Error:Line Number is not Last Line Number+1, Last Line: 41", Kind.REFUSED, 42),
        (b"Error:checksum mismatch, Last Line: 0", Kind.REFUSED, 1),
        (b"Error:No Checksum with line number, Last Line: 9", Kind.REFUSED, 10),
        (b"Resend: 7", Kind.REFUSED, 7),
        (b"okResend: 7", Kind.REFUSED, 7),
        (b"Resend: N7", Kind.REFUSED, 7),
        (b"Error:checksum mismatch, Lass Line: 3", Kind.ERROR, None),
        (b'echo:Unknown command: "M9999"', Kind.UNKNOWN, None),
        (b"start", Kind.RESET, None),
        (b"echo:start", Kind.RESET, None),
        (b"\xfe\x80start", Kind.RESET, None),
        (b" External Reset", Kind.RESET, None),
        (b" Brown out Reset", Kind.RESET, None),
        (b" Watchdog Reset", Kind.RESET, None),
        (b" Software Reset", Kind.RESET, None),
        (b"PowerUp", Kind.RESET, None),
        (b"Marlin 2.1.2.5", Kind.RESET, None),
        (b"Marlin bugfix-2.1.x", Kind.RESET, None),
        (b"Error:Printer halted. kill() called!", Kind.HALTED, None),
        (b"echo:M112 Shutdown", Kind.HALTED, None),
        (b"Printer stopped due to errors. Fix the error and use M999 to restart.", Kind.HALTED, None),
        (b"FIRMWARE_NAME:Marlin 2.1.3 (x) SOURCE_CODE_URL:y", Kind.OTHER, None),
        (b"//action:start", Kind.OTHER, None),
        (b"X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:1600 Y:0 Z:0", Kind.OTHER, None),
        (b"echo: Last Updated: 2024", Kind.OTHER, None),
    ],
)
def test_lines_are_understood(raw: bytes, kind: Kind, number: int | None) -> None:
    found = read_line(raw)
    assert (found.kind, found.number) == (kind, number)


@given(st.binary(max_size=100))
def test_no_line_is_too_strange(raw: bytes) -> None:
    found = read_line(raw)
    assert (found.number is not None) >= (found.kind is Kind.REFUSED)


@pytest.mark.parametrize(
    ("line", "x"),
    [
        ("X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:1600 Y:0 Z:0", "90.00"),
        ("X:-0.05 Y:0.00 Z:0.00 Count X:-1 Y:0 Z:0", "-0.05"),
        ("X:363.600 Y:0.000 Count X: 6464 Y: 0", "363.600"),
        ("X:90.00 Count X:1600", "90.00"),
        ("X:90.00 Y:0.00 Count A:1600 B:0", "90.00"),
        ("X:90.00 Y:0.00 Z:0.00 Count X:1600ok", "90.00"),
        ("X:90.0", None),
        ("X:90.00 Y:0.00 Z:0.00 E:0.0", None),
        ("X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:", None),
        ("X:9\ufffd.00 Y:0.00 Z:0.00 E:0.00 Count X:1600", None),
        ("X:900 Y:0.00 Z:0.00 E:0.00 Count X:1600", None),
        (" Count X:1600 Y:0 Z:0", None),
        ("0.00 Y:0.00 Count X:1600", None),
        ("okX:90.00 Y:0.00 Count X:1600", None),
    ],
)
def test_positions_of_every_version_are_read_and_cut_ones_refused(line: str, x: str | None) -> None:
    found = POSITION.search(line)
    assert (None if found is None else found[1]) == x


def test_firmware_and_capabilities_are_read() -> None:
    about = "FIRMWARE_NAME:Marlin 2.1.3 (Oct 1 2023) SOURCE_CODE_URL:github.com/x PROTOCOL_VERSION:1.0 MACHINE_TYPE:3D Printer"
    assert (FIRMWARE.search(about) or [""])[1] == "Marlin 2.1.3 (Oct 1 2023)"
    assert (FIRMWARE.search("FIRMWARE_NAME:Marlin 1.1.9") or [""])[1] == "Marlin 1.1.9"
    assert FIRMWARE.search("FIRMWARE_NAME:Repetier_1.0") is None
    assert (CAPABILITY.search("Cap:EMERGENCY_PARSER:1") or [""])[1] == "EMERGENCY_PARSER"
    assert CAPABILITY.search("Cap:EMERGENCY_PARSER:0") is None


def test_start_on_a_board_that_runs(talk: Talk) -> None:
    assert talk.link.ready
    assert talk.link.firmware == "Marlin 2.1.3 (Oct 23 2023 10:00:00)"
    assert talk.link.capabilities == {"EMERGENCY_PARSER"}
    assert talk.link.sessions == 1


@dataclass(frozen=True)
class Greeting:
    """What comes when the port is opened, and before what time the first line is sent."""

    name: str
    heard: tuple[Any, ...]
    sent_s: tuple[float, float]


@pytest.mark.parametrize(
    "case",
    [
        Greeting("silence", (), (3.0, 3.0)),
        Greeting("banner", (1.5, "start", " External Reset", "Marlin 2.1.2.5", 0.1, "echo: Free Memory: 1"), (2.0, 2.3)),
        Greeting("older banner", (0.5, "echo:start", "PowerUp"), (0.9, 1.1)),
        Greeting("noise before start", (0.5, b"\x80\x00\xfestart\n"), (0.9, 1.1)),
        Greeting("chatter", (1.0, "wait", 1.0, "wait", 0.5, "ok"), (3.0, 3.0)),
    ],
    ids=lambda case: case.name,
)
def test_greetings(case: Greeting, make_board: Any) -> None:
    script = Script(make_board().clock, *GREETING)
    script.answer(*case.heard)
    times: list[float] = []
    write = script.write
    script.write = lambda data: (times.append(script.clock.now_s()), write(data))[1]  # type: ignore[method-assign]
    MarlinLink(script).start()
    assert case.sent_s[0] <= times[0] <= case.sent_s[1]


def test_a_late_greeting_begins_anew(make_board: Any) -> None:
    script = Script(make_board().clock, (GREETING[0][0], (1.0, "start", "Marlin 2.1.3", "echo: x")), *GREETING)
    link = MarlinLink(script)
    link.start()
    assert link.ready
    assert link.sessions == 1


def test_a_board_that_keeps_starting_is_given_up(make_board: Any) -> None:
    script = Script(make_board().clock, *[(GREETING[0][0], (0.1, "start"))] * 3)
    with pytest.raises(LostError, match="was reset"):
        MarlinLink(script).start()


def test_the_line_number_of_a_former_session_does_not_matter(make_board: Any) -> None:
    refusal = ("Error:checksum mismatch, Last Line: 57", "Resend: 58", "ok")
    MarlinLink(Script(make_board().clock, (GREETING[0][0], refusal), *GREETING)).start()


def test_another_firmware_is_told(make_board: Any) -> None:
    script = Script(make_board().clock, GREETING[0], *[(f"N{n} M115", ("Grbl 1.1f", "ok")) for n in (1, 2, 3)])
    link = MarlinLink(script)
    with pytest.raises(NoAnswerError, match=r"does not answer M115 as Marlin does \('Grbl 1.1f'\)"):
        link.start()
    assert not link.ready


def test_silence_is_told_in_time(make_board: Any) -> None:
    script = Script(make_board().clock, *[(GREETING[0][0], ())] * 6)
    with pytest.raises(NoAnswerError, match="turntable on fake: did not answer after M110 N0; check supply, cable, port and baud rate"):
        MarlinLink(script).start()
    assert script.clock.now_s() < 30.0


def test_nothing_is_sent_before_the_start(make_board: Any) -> None:
    link = MarlinLink(Script(make_board().clock))
    with pytest.raises(LostError, match="not connected"):
        link.command("M400")


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

    talk.script.read = gone  # type: ignore[method-assign]
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


@dataclass(frozen=True)
class Hit:
    """A fault of one line on the wire."""

    kind: str
    at: int
    part: float
    late_s: float

    def __call__(self, data: bytes) -> list[tuple[float, bytes]]:
        """Return what becomes of bytes."""
        where = min(int(self.part * len(data)), len(data) - 1)
        changed = data[:where] + bytes((data[where] ^ (1 << (self.at % 8)),)) + data[where + 1 :]
        return {
            "lost": [(0.0, b"")],
            "damaged": [(0.0, changed)],
            "doubled": [(0.0, data), (self.late_s / 100.0, data)],
            "late": [(self.late_s, data)],
            "cut": [(0.0, data[:where])],
            "glued": [(0.0, b"T:20.0 " + data)],
            "split": [(0.0, data[:where]), (0.2, data[where:])],
        }[self.kind]


KINDS = ["lost", "damaged", "doubled", "late", "cut", "glued", "split"]
hits = st.builds(
    Hit, st.sampled_from(KINDS), st.integers(0, 70), st.floats(0.0, 1.0), st.sampled_from((0.004, 0.05, 0.3, 0.7, 2.0, 9.0, 11.0, 30.0))
)
requests = st.builds(Hit, st.sampled_from(["lost", "damaged", "cut"]), st.integers(0, 40), st.floats(0.0, 1.0), st.just(0.0))
resets = st.dictionaries(st.integers(0, 40), st.sampled_from(("", "start\n Watchdog Reset\nMarlin 2.1.2.5\n")), max_size=1)


@settings(max_examples=400, deadline=None)
@given(
    replies=st.lists(hits, max_size=3),
    asked=st.lists(requests, max_size=2),
    resets=resets,
    speaks=st.sampled_from(({}, {"ok_after_resend": False}, {"advanced_ok": True}, {"keeps_alive": False}, {"greets": True})),
    angles=st.lists(st.sampled_from((0.0, 9.0, 18.0, 90.0, 351.0)), min_size=1, max_size=3),
)
def test_no_wrong_angle_is_ever_believed_and_nothing_hangs(
    make_board: Callable[..., Any],
    replies: list[Hit],
    asked: list[Hit],
    resets: dict[int, str],
    speaks: dict[str, bool],
    angles: list[float],
) -> None:
    board = make_board(
        reply_faults={hit.at: hit for hit in replies}, request_faults={hit.at: hit for hit in asked}, resets=resets, **speaks
    )
    table = MarlinTurntable(MarlinLink(board), replace(TurntablePart(), speed_deg_per_s=30.0), board.clock)
    try:
        table.prepare()
        assert not table.knows_zero()
        table.declare(4.5)
        assert board.x_deg == 364.5
        for angle in angles:
            begin_s = board.clock.now_s()
            assert table.move_to(angle) == angle == board.x_deg - 360.0
            assert board.at_rest
            assert board.clock.now_s() - begin_s < 200.0
        assert table.position_deg() == angles[-1]
        table.release()
        assert not board.energised
        assert not table.knows_zero()
    except RigError:
        pass
    assert board.clock.now_s() < 700.0
