"""How a link to a Marlin board begins: what it says when the port is opened, and who answers."""

from dataclasses import dataclass
from typing import Any

import pytest

from rhizotwin.rig.errors import LostError, NoAnswerError
from rhizotwin.rig.table.marlin import MarlinLink
from tests.rig.table.marlin_script import GREETING, Script, Talk


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
    MarlinLink(script).start()
    assert case.sent_s[0] <= script.sent_s[0] <= case.sent_s[1]


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
