"""Transmission of one command to the board until it is received: sending, answers, rejections and repetitions."""

import re
from dataclasses import dataclass, field

from rhizotwin.rig.errors import NoAnswerError, RigError
from rhizotwin.rig.table.marlin_lines import Kind, Line, encode_line
from rhizotwin.rig.table.marlin_wire import MarlinWire

ANSWER_S = 10.0
"""Silence, in addition to the expected duration of a command, after which it is sent again."""
BUSY_S = 3.0
"""The same after the board has reported that it is busy, which it does every `BUSY_EVERY_S`."""
BUSY_EVERY_S = 2
AGAIN_S = 3.0
"""The same after a repetition because of silence."""
TRAILING_S = 0.5
"""Time-out of a line that should follow immediately: the ``ok`` after ``Resend``, which some versions omit."""
LONGEST_S = 60.0
"""Maximum duration of a command in addition to twice its expected duration, regardless of the board's output."""
MOST_REFUSALS = 10
MOST_SILENCES = 5
MOST_HINTS = 2
"""Maximum number of early repetitions because of a line that resembles an ``ok``."""
MOST_COPIES = 6
MOST_LINES = 2000
_KEPT = 50


@dataclass(frozen=True)
class Sent:
    """A line that was sent."""

    text: str
    data: bytes

    @property
    def command(self) -> str:
        """First word of the command, such as G1."""
        return self.text.split()[0]


@dataclass
class Journal:
    """Lines of a session by number, in case the board requests one again."""

    last: int = 0
    lines: dict[int, Sent] = field(default_factory=lambda: {0: Sent("M110 N0", encode_line(0, "M110 N0"))})
    optional: set[str] = field(default_factory=set)
    """Commands that the firmware need not support."""

    def add(self, text: str, *, optional: bool) -> None:
        """Add a command with the next number; an interruption leaves the journal consistent."""
        number = self.last + 1
        sent = Sent(text, encode_line(number, text))
        if optional:
            self.optional.add(sent.command)
        self.lines[number] = sent
        self.last = number
        self.lines.pop(number - _KEPT, None)


class Exchange:
    """Transmission of the last line of a journal.

    Parameters
    ----------
    expect_s
        Maximum time of the board until its ``ok``.
    awaited
        Pattern that must occur in the answers.
    """

    def __init__(self, wire: MarlinWire, journal: Journal, *, expect_s: float, awaited: re.Pattern[str] | None) -> None:
        self._wire = wire
        self._journal = journal
        self._expect_s = expect_s
        self._awaited = awaited
        # line in transmission: the last one, or an earlier one that the board did not receive
        self._number = journal.last
        self._quiet_s = wire.clock.now_s()  # time at which silence becomes too long
        self._end_s = self._quiet_s + LONGEST_S + 2.0 * expect_s
        self._output: list[str] = []
        self._answered = awaited is None
        self._acknowledged = False
        self._wanted: set[int] = set()  # numbers in the rejection that is being read
        self._refused = False
        self._doubtful = False  # an unrecognised error occurred: the next ok confirms nothing
        self._copies = 0  # number of unanswered copies of the line
        self._refusals = self._silences = self._hints = self._waits = 0
        self._hinted = False
        self._unknown_text: str | None = None

    def run(self) -> list[str]:
        """Send the line until the board has received it; return the printed lines.

        Raises
        ------
        NoAnswerError
            If the board has not received it after every retry.
        LostError
            If the board was reset, halted, or was unplugged.
        """
        self._wire.fresh()
        self._send()
        for _ in range(MOST_LINES):
            if self._acknowledged and self._copies <= 0 and self._answered:
                return self._output
            line = self._wire.next(min(self._quiet_s, self._end_s))
            if line is not None:
                self._hear(line)
            elif self._silence():
                return self._output
        raise self._no_answer("kept sending other lines")

    def check_known(self) -> None:
        """Raise `RigError` if the firmware reported an unknown command."""
        if self._unknown_text is not None:
            raise RigError(
                f'{self._wire.name}: the firmware does not support "{self._unknown_text}"; '
                "build Marlin 2.1 with the options that the docs list"
            )

    def _send(self, *, patience_s: float | None = None) -> None:
        if self._copies < MOST_COPIES:
            self._wire.send(self._journal.lines[self._number].data)
            self._copies += 1
        self._waits = 0
        self._hinted = False
        self._quiet_s = self._wire.clock.now_s() + (self._expect_s + ANSWER_S if patience_s is None else patience_s)

    def _silence(self) -> bool:
        """Handle a missing answer; return whether the exchange is over."""
        if self._refused:
            self._refusal()
            return False
        if self._acknowledged:
            return True
        if self._wire.clock.now_s() >= self._end_s:
            raise self._no_answer("was busy without end")
        if self._hinted:
            self._hints += 1
            self._send()
            return False
        self._silences += 1
        if self._silences > MOST_SILENCES:
            raise self._no_answer("did not reply")
        self._send(patience_s=AGAIN_S)
        return False

    def _hear(self, line: Line) -> None:
        now_s = self._wire.clock.now_s()
        self._wire.check(line)
        if line.kind is Kind.REFUSED and line.number is not None:
            self._refused = True
            self._wanted.add(line.number)
            self._quiet_s = now_s + TRAILING_S
        elif line.kind is Kind.OK:
            self._handle_ok(line)
        elif line.kind is Kind.BUSY:
            if not self._refused:
                self._silences = 0
                self._quiet_s = now_s + BUSY_S
        elif line.kind is Kind.WAIT:
            self._waits += 1
            # the first may have crossed with our line; the second means that no ok will follow
            if self._waits == 2 and not self._refused:
                self._quiet_s = now_s
        elif line.kind is Kind.UNKNOWN:
            self._unknown(line.text)
        elif line.kind is Kind.ERROR:
            self._doubtful = True
            self._print(line.text)
        else:
            self._print(line.text)
            if (line.kind is Kind.LIKE_OK or self._hinted) and self._hints < MOST_HINTS and not (self._acknowledged or self._refused):
                self._hinted = True
                self._quiet_s = now_s + TRAILING_S

    def _handle_ok(self, line: Line) -> None:
        """Handle an ``ok``."""
        now_s = self._wire.clock.now_s()
        if self._refused:
            self._refusal()
        elif line.number is not None and line.number != self._number:  # ADVANCED_OK: that of another line, or damaged
            self._hinted = self._hints < MOST_HINTS
            self._quiet_s = min(self._quiet_s, now_s + TRAILING_S) if self._hinted else self._quiet_s
        elif self._doubtful:
            self._doubtful = False
            self._copies -= 1
            self._silences += 1
            if self._silences > MOST_SILENCES:
                raise self._no_answer("answered with errors")
            self._send()
        elif self._number < self._journal.last:
            self._number += 1
            self._copies = 0
            self._send()
        else:
            self._acknowledge()
            self._copies -= 1

    def _acknowledge(self) -> None:
        """Wait a little longer if answers to further copies, or the required output, are still to come.

        The required output may take as long as the command, as the ``ok`` may have been that of an earlier one.
        """
        self._acknowledged = True
        self._quiet_s = self._wire.clock.now_s() + TRAILING_S + (0.0 if self._answered else self._expect_s)

    def _refusal(self) -> None:
        """Handle a complete rejection: send the requested line."""
        # its two lines contradict each other, so that one is damaged
        wanted = self._wanted.pop() if len(self._wanted) == 1 else None
        self._wanted.clear()
        self._refused = self._doubtful = False
        self._copies -= 1
        if wanted == self._journal.last + 1:
            if not self._acknowledged:
                self._copies -= 1  # answers arrive in order: the ok of the first copy was lost
            self._acknowledge()
            return
        if wanted == 1 and self._number > 1:
            raise self._wire.was_reset("its line numbers restarted")
        self._refusals += 1
        if self._refusals > MOST_REFUSALS:
            raise self._no_answer(f"rejected it {MOST_REFUSALS} times")
        if wanted is not None and wanted in self._journal.lines and wanted <= self._journal.last:
            if wanted != self._number:
                self._copies = 0
            self._number = wanted
        self._acknowledged = False
        self._send()

    def _unknown(self, quoted: str) -> None:
        """Handle a command reported as unknown: one of ours, or one that was damaged in transmission."""
        name = quoted.split()[0] if quoted.split() else ""
        if name in self._journal.optional:
            return
        if any(sent.command == name for sent in self._journal.lines.values()):
            self._unknown_text = quoted
        else:
            self._doubtful = True

    def _print(self, text: str) -> None:
        self._output.append(text)
        self._answered = self._answered or (self._awaited is not None and self._awaited.search(text) is not None)

    def _no_answer(self, what: str) -> NoAnswerError:
        heard = f" (last received: {self._output[-1]!r})" if self._output else ""
        text = self._journal.lines[self._number].text
        return NoAnswerError(f"{self._wire.name}: {what} after {text}{heard}; check supply, cable, port and baud rate, then start again")
