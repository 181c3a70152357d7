"""The bytes on the wire to and from a Marlin board, and the link to it: how it begins, and every fault that an answer can have."""

from contextlib import suppress
from typing import Any

import pytest

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.marlin_exchange import ANSWER_S, BUSY_S, LONGEST_S
from rhizotwin.rig.table.marlin_lines import POSITION, Kind, encode_line, read_line
from tests.rig.fake_time import Time
from tests.rig.table.marlin_script import GREETING, POSITION_LINE, Script, Talk

M110, M400 = "N0 M110 N0", "N8 M400"
NEXT = ("N9 M17", ("ok",))
REFUSED = ("Error:checksum mismatch, Last Line: 7", "Resend: 8", "ok")
TWICE = ("Error:Line Number is not Last Line Number+1, Last Line: 8", "Resend: 9", "ok")
WANTS_8 = ("Error:Line Number is not Last Line Number+1, Last Line: 7", "Resend: 8", "ok")
MOVED = "X:9.00 Y:0.00 Z:0.00 E:0.00 Count X:160 Y:0 Z:0"


TROUBLES: dict[str, tuple[list[tuple[Any, ...]], float, float]] = {
    "split": ([(b"o", 0.1, b"k", 0.1, b"\r\n")], 0.2, 0.3),
    "busy for long": ([(*(2.0, "echo:busy: processing") * 20, 1.0, "ok")], 41.0, 41.0),
    "damaged on its way": ([REFUSED, ("ok",)], 0.0, 0.1),
    "no ok after the resend": ([REFUSED[:2], ("ok",)], 0.5, 0.6),
    "only a damaged error": ([("Error:checksum mi", "ok"), TWICE], 0.0, 0.1),
    "ok lost": ([(), TWICE], ANSWER_S, ANSWER_S + 0.1),
    "late beyond patience": ([(11.0, "ok"), (1.5, *TWICE)], 11.0, 11.6),
    "busy, then silence": ([(2.0, "echo:busy: processing"), TWICE], 2.0 + BUSY_S, 2.1 + BUSY_S),
    "number of another line": ([("ok N7 P15 B3", 0.1, "ok N8 P15 B3")], 0.1, 0.2),
    "unknown on its way": ([('echo:Unknown command: "^8 M400*47"', "ok"), ("ok",)], 0.0, 0.6),
}
"""Answers to M400 as line 8 and to its copies, and how long they may keep the link, in seconds."""


@pytest.mark.parametrize(("answers", "least_s", "most_s"), TROUBLES.values(), ids=TROUBLES)
def test_a_command_gets_through(answers: list[tuple[Any, ...]], least_s: float, most_s: float, talk: Talk) -> None:
    link = talk.then(*[(M400, answer) for answer in answers], NEXT)
    link.command("M400")
    assert least_s <= talk.since_s() <= most_s
    assert talk.script.steps == [NEXT]
    link.command("M17")
    assert not talk.script.steps


LOST = [
    ("start",),
    ("Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok"),
    ("ok", "Error:Printer halted. kill() called!"),
]


@pytest.mark.parametrize("answers", LOST, ids=lambda answers: answers[0])
def test_a_lost_board_stays_lost_until_it_is_started(answers: tuple[str, ...], talk: Talk) -> None:
    link = talk.then((M400, answers), ("N9 M17", ()))
    with suppress(LostError):
        link.command("M400")
    with pytest.raises(LostError, match="turntable on fake: the board"):
        link.command("M17")
    talk.script.steps.clear()
    assert not link.ready
    talk.script.steps += GREETING
    link.start()
    assert link.ready
    assert link.sessions == 2


HOPELESS = {
    "silence": ([()] * 6, "did not reply after M400", 26.0),
    "refused for ever": ([REFUSED] * 11, "rejected the line 10 times after M400", 6.0),
    "busy for ever": ([(2.0, "echo:busy: processing") * 200], "the board remained busy after M400", LONGEST_S + 2.0),
    "noise for ever": ([(b"\xaa" * 4096,) * 20], "sends invalid data continuously", 1.0),
}


@pytest.mark.parametrize(("answers", "says", "most_s"), HOPELESS.values(), ids=HOPELESS)
def test_what_never_ends_is_ended(answers: list[tuple[Any, ...]], says: str, most_s: float, talk: Talk) -> None:
    link = talk.then(*[(M400, answer) for answer in answers])
    with pytest.raises(NoAnswerError, match=says):
        link.command("M400")
    assert talk.since_s() <= most_s
    assert link.ready  # it was not reset: the link finds a new beginning
    talk.script.steps.clear()
    talk.script.waiting.clear()
    # Line 8 was never taken: the board wants it before line 9.
    talk.then(("N9 M114", WANTS_8), (M400, ("ok",)), ("N9 M114", (POSITION_LINE, "ok")), ("N10 M17", ("ok",)))
    link.command("M17")
    assert not talk.script.steps


def test_an_answer_is_waited_for_behind_an_earlier_ok(talk: Talk) -> None:
    """The doubled ``ok`` of G1 passes for that of M400, whose own comes before the position."""
    asked = ("N9 M114", (2.0, "echo:busy: processing", 1.5, "ok", MOVED, "ok"))
    link = talk.then((M400, (0.001, "ok")), asked, ("N10 M17", ("ok",)))
    link.command("M400", expect_s=3.0)
    assert link.ask("M114", POSITION)[1] == "9.00"
    assert talk.since_s() == pytest.approx(3.501)
    link.command("M17")


def test_a_lost_position_is_requested_anew(talk: Talk) -> None:
    steps = ("N8 M114", ("ok",)), ("N9 M114", ("X:0.0", "ok")), ("N10 M114", (POSITION_LINE, "ok"))
    assert talk.then(*steps).ask("M114", POSITION)[1] == "0.00"
    assert not talk.script.steps


def test_a_refusal_that_was_overlooked_is_made_good(talk: Talk) -> None:
    """A doubled ``ok`` passed for that of line 8, whose refusal was lost: the board wants 8 before 9."""
    link = talk.then((M400, ("ok",)), ("N9 M17", WANTS_8), (M400, ("ok",)), NEXT)
    link.command("M400")
    link.command("M17")
    assert not talk.script.steps


def test_after_ctrl_c_the_answers_still_to_come_are_waited_for(talk: Talk) -> None:
    link = talk.then((M400, (24.0, "ok")), ("N9 M114", ("ok", 24.0, POSITION_LINE, "ok")), ("N10 M17", ("ok",)))
    talk.script.interrupt = True
    with pytest.raises(KeyboardInterrupt):
        link.command("M400", expect_s=24.0)
    link.command("M17")
    assert not talk.script.steps
    assert talk.since_s() == pytest.approx(24.0)


def test_start_on_a_board_that_runs_whatever_its_line_number(talk: Talk) -> None:
    assert talk.link.ready
    assert talk.link.firmware == "Marlin 2.1.3 (Oct 23 2023 10:00:00)"
    assert talk.link.sessions == 1
    refusal = ("Error:checksum mismatch, Last Line: 57", "Resend: 58", "ok")
    MarlinLink(Script(Time(), (GREETING[0][0], refusal), *GREETING)).start()


def test_a_late_greeting_begins_anew_but_not_for_ever() -> None:
    link = MarlinLink(Script(Time(), (GREETING[0][0], (1.0, "start", "Marlin 2.1.3", "echo: x")), *GREETING))
    link.start()
    assert link.ready
    assert link.sessions == 1
    with pytest.raises(LostError, match="was reset"):
        MarlinLink(Script(Time(), *[(GREETING[0][0], (0.1, "start"))] * 3)).start()


def reply(name: str, ok: str = "ok") -> list[tuple[str, tuple[str, ...]]]:
    return [GREETING[0], *[(f"N{n} M115", (name, "Cap:EEPROM:0", "ok") if ok else (f"ok {name}",)) for n in (1, 2, 3)]]


FOREIGN: dict[str, list[tuple[str, tuple[str, ...]]]] = {
    "Grbl 1.1h": [(M110, ("", "Grbl 1.1h ['$' for help]"))],
    "FluidNC v3.7.17": [(M110, ("Grbl 3.7 [FluidNC v3.7.17 (wifi) '$' for help]",))],
    "Grbl, grblHAL or FluidNC": [(M110, ("error:20",))],
    "Grbl 0.9j": [(M110, ("Grbl 0.9j ['$' for help]",))],
    "TinyG or g2core": [(M110, ('{"r":{"gc":"N0M110"},"f":[1,108,12,1234]}',))],
    "Prusa-Firmware 3.13.2 based on Marlin": reply("FIRMWARE_NAME:Prusa-Firmware 3.13.2 based on Marlin FIRMWARE_URL:https://x"),
    "RepRapFirmware for Duet 2 WiFi 3.4.5": reply("FIRMWARE_NAME: RepRapFirmware for Duet 2 WiFi FIRMWARE_VERSION: 3.4.5"),
    "Smoothieware edge-94de12c": reply("FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//x, X-SOURCE:y, FIRMWARE_VERSION:edge-94de12c, Z"),
    "Repetier_0.92.9": reply("FIRMWARE_NAME:Repetier_0.92.9 FIRMWARE_URL:https://x PROTOCOL_VERSION:1.0"),
    "Klipper v0.12.0": reply("FIRMWARE_NAME:Klipper FIRMWARE_VERSION:v0.12.0", ""),  # as Klipper 84104bb replies on its terminal
    "Teacup": reply("FIRMWARE_NAME:Teacup FIRMWARE_URL:http%3A//github.com/traumflug PROTOCOL_VERSION:1.0", ""),
}


@pytest.mark.parametrize(("name", "steps"), FOREIGN.items(), ids=FOREIGN)
def test_another_firmware_is_named_at_once(name: str, steps: list[Any]) -> None:
    script = Script(Time(), *steps)
    link = MarlinLink(script)
    with pytest.raises(RigError, match=f"^turntable on fake: the board runs {name}; Marlin 2.1 is required"):
        link.start()
    assert not link.ready
    assert script.clock.now_s() < 5.0


SENT = [
    (0, "M110 N0", b"N0 M110 N0*125\n"),
    (3, "G1 X3.6 F1800", b"N3 G1 X3.6 F1800*23\n"),
    (6, "M150 S0 R255 U255 B255 P255", b"N6 M150 S0 R255 U255 B255 P255*119\n"),
]


def test_lines_have_number_and_checksum() -> None:
    assert [encode_line(number, text) for number, text, _ in SENT] == [sent for _, _, sent in SENT]
    for text in ("G1 X1;", "M117 *", "G1\nG1", "M117 é", "M117 " + "x" * 90):
        with pytest.raises(ValueError):
            encode_line(1, text)


MEANINGS = {
    (Kind.OK, None): [b"ok\r", b"ok T:20.0 /0.0", b"\xff\x00ok"],
    (Kind.OK, 7): [b"ok N7 P15 B3"],
    (Kind.LIKE_OK, None): [b"okay", b"o\xebk"],
    (Kind.REFUSED, 7): [b"Resend: 7", b"okResend: 7"],
    (Kind.ERROR, None): [b"Error:checksum mismatch, Lass Line: 3"],
    (Kind.UNKNOWN, None): [b'echo:Unknown command: "M9999"'],
    (Kind.RESET, None): [b"\xfe\x80start", b"PowerUp", b"Marlin bugfix-2.1.x", b" External Reset", b" Brown out Reset", b" Watchdog Reset"],
    (Kind.HALTED, None): [b"Error:Printer halted. kill() called!", b"echo:M112 Shutdown"],
    (Kind.OTHER, None): [b"FIRMWARE_NAME:Marlin 2.1.3 (x) SOURCE_CODE_URL:y", b"//action:start", b"X:90.00 Y:0.00 Count X:1600"],
}


def test_lines_are_understood() -> None:
    found = {raw: (line.kind, line.number) for lines in MEANINGS.values() for raw in lines for line in [read_line(raw)]}
    assert found == {raw: meaning for meaning, lines in MEANINGS.items() for raw in lines}


POSITIONS = {
    "X:-0.05 Y:0.00 Z:0.00 Count X:-1 Y:0 Z:0": "-0.05",
    "X:363.600 Y:0.000 Count X: 6464 Y: 0": "363.600",
    "X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:": None,
    "X:900 Y:0.00 Z:0.00 E:0.00 Count X:1600": None,
    "okX:90.00 Y:0.00 Count X:1600": None,
}


def test_positions_are_read_and_cut_ones_refused() -> None:
    assert {line: found and found[1] for line in POSITIONS for found in [POSITION.search(line)]} == POSITIONS
