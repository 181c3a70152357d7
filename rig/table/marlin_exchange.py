"""Transmission of one command to a Marlin board.

The command is repeated until the board has received it.
"""

import re
from dataclasses import dataclass, field

from rhizotwin.rig.errors import NoAnswerError, RigError
from rhizotwin.rig.table.marlin_lines import Kind, Line, encode_line
from rhizotwin.rig.table.marlin_wire import MarlinWire

ANSWER_S = 10.0
"""Time without a reply after which a command is sent again, s. The command's expected duration is added to it."""
BUSY_S = 3.0
"""Time without a further reply after which a command is sent again if the board has reported that it is busy, s. The
board repeats this report every `BUSY_EVERY_S`."""
BUSY_EVERY_S = 2
AGAIN_S = 3.0
"""Time without a reply after which a command is sent again if it was already repeated for lack of a reply, s."""
TRAILING_S = 0.5
"""Timeout for the ``ok`` after ``Resend``, s. The ``ok`` should follow immediately, but some firmware versions omit
it."""
LONGEST_S = 60.0
"""Maximum time that is spent on a command, s, even if the board keeps sending output. Twice the command's expected
duration is added to it."""
MOST_REFUSALS = 10
MOST_SILENCES = 5
MOST_HINTS = 2
"""Maximum number of times a command is repeated early because the board has sent a line that resembles ``ok``."""
MOST_COPIES = 6
MOST_LINES = 2000
_KEPT = 50


@dataclass(frozen=True)
class Sent:
    """Command that was sent, as text and as the encoded line."""

    text: str
    data: bytes

    @property
    def command(self) -> str:
        """First word of the command, such as G1."""
        return self.text.split()[0]


@dataclass
class Journal:
    """Numbered lines of a session.

    The board can request recent lines again.
    """

    last: int = 0
    lines: dict[int, Sent] = field(default_factory=lambda: {0: Sent("M110 N0", encode_line(0, "M110 N0"))})
    optional: set[str] = field(default_factory=set)
    """Commands that the firmware may lack without an error."""

    def add(self, text: str, *, optional: bool) -> None:
        """Add a command with the next line number.

        The journal remains consistent if the method is interrupted.
        """
        number = self.last + 1
        sent = Sent(text, encode_line(number, text))
        if optional:
            self.optional.add(sent.command)
        self.lines[number] = sent
        self.last = number
        self.lines.pop(number - _KEPT, None)


class Exchange:
    """Transmission of the last line of a journal, which is repeated until the board has received it.

    Parameters
    ----------
    expect_s
        Maximum time until the board sends ``ok``, s.
    awaited
        Pattern that must occur in the replies, if any.
    """

    def __init__(self, wire: MarlinWire, journal: Journal, *, expect_s: float, awaited: re.Pattern[str] | None) -> None:
        self._wire = wire
        self._journal = journal
        self._expect_s = expect_s
        self._awaited = awaited
        # line in transmission: the last line, or an earlier line that the board did not receive
        self._number = journal.last
        self._quiet_s = wire.clock.now_s()  # time at which a missing reply counts as lost
        self._end_s = self._quiet_s + LONGEST_S + 2.0 * expect_s
        self._output: list[str] = []
        self._answered = awaited is None
        self._acknowledged = False
        self._wanted: set[int] = set()  # numbers in the rejection that is being read
        self._refused = False
        self._doubtful = False  # an unrecognised error occurred, so that the next ok confirms nothing
        self._copies = 0  # number of copies of the line without a reply
        self._refusals = self._silences = self._hints = self._waits = 0
        self._hinted = False
        self._unknown_text: str | None = None

    def run(self) -> list[str]:
        """Send the line repeatedly until the board has received it, and return the printed lines.

        Raises
        ------
        NoAnswerError
            If the board has not received the line after all retries.
        LostError
            If the board was reset, halted or unplugged.
        """
        self._wire.reset_count()
        self._send()
        for _ in range(MOST_LINES):
            if self._acknowledged and self._copies <= 0 and self._answered:
                return self._output
            line = self._wire.next(min(self._quiet_s, self._end_s))
            if line is not None:
                self._hear(line)
            elif self._silence():
                return self._output
        raise self._no_answer("the board kept sending unrelated lines")

    def check_known(self) -> None:
        """Raise a `RigError` if the firmware has reported that it does not know a command."""
        if self._unknown_text is not None:
            raise RigError(
                f'{self._wire.name}: the firmware does not support "{self._unknown_text}"; '
                "build Marlin 2.1 with the options listed in the documentation"
            )

    def _send(self, *, patience_s: float | None = None) -> None:
        if self._copies < MOST_COPIES:
            self._wire.send(self._journal.lines[self._number].data)
            self._copies += 1
        self._waits = 0
        self._hinted = False
        self._quiet_s = self._wire.clock.now_s() + (self._expect_s + ANSWER_S if patience_s is None else patience_s)

    def _silence(self) -> bool:
        """Decide what to do after a timeout, and return whether the exchange is complete."""
        if self._refused:
            self._refusal()
            return False
        if self._acknowledged:
            return True
        if self._wire.clock.now_s() >= self._end_s:
            raise self._no_answer("the board remained busy")
        if self._hinted:
            self._hints += 1
            self._send()
            return False
        self._silences += 1
        if self._silences > MOST_SILENCES:
            raise self._no_answer("the board did not reply")
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
            if self._awaited is not None and self._awaited.search(line.text):
                self._print(line.text)
            self._handle_ok(line)
        elif line.kind is Kind.BUSY:
            if not self._refused:
                self._silences = 0
                self._quiet_s = now_s + BUSY_S
        elif line.kind is Kind.WAIT:
            self._waits += 1
            # the first may have been sent before our line arrived; the second means that no ok will follow
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
        """Handle an ``ok`` from the board."""
        now_s = self._wire.clock.now_s()
        if self._refused:
            self._refusal()
        elif line.number is not None and line.number != self._number:  # ADVANCED_OK of a different line, or a damaged number
            self._hinted = self._hints < MOST_HINTS
            self._quiet_s = min(self._quiet_s, now_s + TRAILING_S) if self._hinted else self._quiet_s
        elif self._doubtful:
            self._doubtful = False
            self._copies -= 1
            self._silences += 1
            if self._silences > MOST_SILENCES:
                raise self._no_answer("the board replied with errors")
            self._send()
        elif self._number < self._journal.last:
            self._number += 1
            self._copies = 0
            self._send()
        else:
            self._acknowledge()
            self._copies -= 1

    def _acknowledge(self) -> None:
        """Register that the board has received the line, and wait briefly for outstanding replies.

        If output is required, the waiting time includes the duration of the command, because the ``ok`` may refer to an
        earlier command.
        """
        self._acknowledged = True
        self._quiet_s = self._wire.clock.now_s() + TRAILING_S + (0.0 if self._answered else self._expect_s)

    def _refusal(self) -> None:
        """Send the line that the board has requested in a rejection.

        All lines of the rejection have been received.
        """
        # if the two lines of the rejection contradict each other, one of them is damaged
        wanted = self._wanted.pop() if len(self._wanted) == 1 else None
        self._wanted.clear()
        self._refused = self._doubtful = False
        self._copies -= 1
        if wanted == self._journal.last + 1:
            if not self._acknowledged:
                self._copies -= 1  # replies arrive in order, so that the ok for the first copy was lost
            self._acknowledge()
            return
        if wanted == 1 and self._number > 1:
            raise self._wire.was_reset("the line numbers restarted")
        self._refusals += 1
        if self._refusals > MOST_REFUSALS:
            raise self._no_answer(f"the board rejected the line {MOST_REFUSALS} times")
        if wanted is not None and wanted in self._journal.lines and wanted <= self._journal.last:
            if wanted != self._number:
                self._copies = 0
            self._number = wanted
        self._acknowledged = False
        self._send()

    def _unknown(self, quoted: str) -> None:
        """Handle the report that a command is unknown.

        Either the firmware does not support it, or it was damaged in transmission.
        """
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
        return NoAnswerError(
            f"{self._wire.name}: {what} after {text}{heard}; check supply, cable, port, baud rate and firmware, then start again"
        )
