"""The link to a Marlin board: numbered, checksummed lines, one in flight, each sent again until it is certain that the board took it.

The board takes lines only in the order of their numbers, so a line that is sent twice is done once: the second copy is refused, and the
number that the refusal asks for proves that the first was taken. Whatever happens to an answer is cured in this way. What cannot be seen
from a single answer is an ``ok`` that belongs to an earlier line (late, or doubled). Therefore nothing is believed to be done until a
command that prints something, asked after it, has printed it: see `MarlinLink.ask`.
"""

import re
from collections import deque
from dataclasses import dataclass, field

from rig.errors import LostError, NoAnswerError, RigError
from rig.marlin_lines import CAPABILITY, FIRMWARE, POSITION, Kind, Line, numbered, read_line
from rig.port import Wire

ANSWER_S = 10.0
"""Silence beyond the time that a command is expected to take, after which it is sent again."""
BUSY_S = 3.0
"""The same once the board has said that it is busy; it says so every `BUSY_EVERY_S`."""
BUSY_EVERY_S = 2
AGAIN_S = 3.0
"""Silence after a line that was sent again because of silence."""
TRAILING_S = 0.5
"""How long a line that should come at once is waited for: the ``ok`` behind ``Resend``, which some versions leave out."""
LONGEST_S = 60.0
"""No command lasts longer than this beyond twice the time it is expected to take, whatever the board sends meanwhile."""
BOOT_S = 3.0
"""Boards that start anew when their port is opened greet within this time; others say nothing."""
MOST_REFUSALS = 10
MOST_SILENCES = 5
MOST_HINTS = 2
MOST_COPIES = 6
MOST_LINES = 2000
MOST_BYTES = 65536
STARTS = 3
ASKS = 3
HISTORY = 50


@dataclass(frozen=True)
class _Sent:
    """A line of this session, kept in case the board wants it again."""

    text: str
    data: bytes


@dataclass(kw_only=True)
class _Exchange:
    """Where a command stands."""

    number: int
    """The line in flight: the command's, or an earlier one that the board turned out not to have."""
    expect_s: float
    awaited: re.Pattern[str] | None
    """What must be among the answers."""
    quiet_s: float
    """When silence has lasted too long."""
    end_s: float
    output: list[str] = field(default_factory=list)
    acknowledged: bool = False
    wanted: set[int] = field(default_factory=set)
    """Numbers in the refusal that is just being read."""
    refused: bool = False
    doubtful: bool = False
    """An error came that was not understood: the next ``ok`` proves nothing."""
    copies: int = 0
    """Copies of the line that are not answered yet."""
    refusals: int = 0
    silences: int = 0
    hints: int = 0
    hinted: bool = False
    waits: int = 0
    unknown: str | None = None

    @property
    def answered(self) -> bool:
        """Whether what must be among the answers is there."""
        return self.awaited is None or any(self.awaited.search(line) for line in self.output)


class MarlinLink:
    """The board behind a port. Turntable and lights share one."""

    def __init__(self, port: Wire) -> None:
        self._port = port
        self._name = f"{port.device} on {port.url}"
        self._buffer = bytearray()
        self._lines: deque[Line] = deque()
        self._heard = 0
        self._history: dict[int, _Sent] = {}
        self._last = 0
        self._optional: set[str] = set()
        self._unsettled_s: float | None = None  # how long the command may take that was broken off, by Ctrl-C or for want of an answer
        self._lost: str | None = f"{self._name}: not connected yet"
        self.firmware = ""
        """What M115 says, such as "Marlin 2.1.2.5 (Dec  2 2024 12:00:00)"."""
        self.capabilities: frozenset[str] = frozenset()
        self.sessions = 0
        """How often the link was started: what was known of the board before is to be asked again."""

    @property
    def name(self) -> str:
        """Device and port, for messages."""
        return self._name

    @property
    def ready(self) -> bool:
        """Whether the link was started and the board was not lost since."""
        return self._lost is None

    def start(self) -> None:
        """Agree on line numbers, ask for the firmware, switch off what it would do by itself. Table and lights are left as they are.

        Raises
        ------
        NoAnswerError
            When nothing answers, or what answers is not Marlin.
        LostError
            When the board keeps starting anew, is halted, or was unplugged.
        """
        for tries_left in reversed(range(STARTS)):
            try:
                self._greet()
            except RigError as error:
                self._lost = str(error)
                if not (isinstance(error, LostError) and tries_left):
                    raise
            else:
                return

    def command(self, text: str, *, expect_s: float = 0.0, optional: bool = False) -> list[str]:
        """Have a command taken; return what the board printed meanwhile.

        That it was taken does not mean that it is done: moves are only queued, and an ``ok`` may have belonged to an earlier command.
        Whoever needs to know goes on with `ask`.

        Parameters
        ----------
        text
            Without number and checksum.
        expect_s
            How long the board may need until its ``ok``.
        optional
            Whether a firmware that does not know the command will do.

        Raises
        ------
        NoAnswerError
            When the board did not take it after every retry; the link may be used on.
        LostError
            When the board was reset, halted or unplugged, now or since the last `start`.
        RigError
            When the firmware does not know the command.
        """
        return self._guarded(text, expect_s=expect_s, optional=optional, awaited=None)

    def ask(self, text: str, pattern: re.Pattern[str], *, expect_s: float = 0.0) -> re.Match[str]:
        """Have a command answered. The board works in order: everything sent before is done then (moves: if M400 was sent behind them).

        Parameters
        ----------
        pattern
            Searched for in each line of the answer. It must refuse lines that were cut short; a digit may still be wrong.

        Raises
        ------
        NoAnswerError, LostError, RigError
            As `command`; and when the answers cannot be understood.
        """
        return self._ask(text, pattern, expect_s=expect_s)[0]

    def quick_stop(self) -> bool:
        """Stop a move at once, where the firmware can (EMERGENCY_PARSER); return whether it can. The table's angle is forgotten."""
        if "EMERGENCY_PARSER" not in self.capabilities or not self.ready:
            return False
        try:
            self._port.write(b"M410\n")  # acts as it is received, whatever waits before it
        except LostError as error:
            self._lost = str(error)
            raise
        self._unsettled_s = self._unsettled_s or 0.0
        self.sessions += 1
        self.command("G92 X0")
        self.ask("M114", POSITION)
        return True

    def close(self) -> None:
        """Close the port; nothing when it is closed already."""
        self._lost = f"{self._name}: closed"
        self._port.close()

    def _greet(self) -> None:
        self._listen_to_greeting()
        self._history.clear()
        self._last = 0
        self._unsettled_s = None
        self._history[0] = _Sent("M110 N0", numbered(0, "M110 N0"))
        self._exchange(expect_s=0.0, awaited=None)
        self._lost = None
        about, lines = self._ask("M115", FIRMWARE, expect_s=0.0)
        self.firmware = about[1]
        self.capabilities = frozenset(found[1] for line in lines if (found := CAPABILITY.search(line)))
        self.sessions += 1
        self.command(f"M113 S{BUSY_EVERY_S}", optional=True)
        for reports in ("M155 S0", "M154 S0"):  # they would get between the answers
            self.command(reports, optional=True)
        self.command("M211 S0", optional=True)  # software endstops
        self.command("M18 S0")  # or the idle motor is released, and the angle with it
        self.ask("M114", POSITION)

    def _listen_to_greeting(self) -> None:
        """Wait for the greeting of a board that starts, to its end, or for the silence of one that runs already."""
        clock = self._port.clock
        self._heard = 0
        until_s = clock.now_s() + BOOT_S
        latest_s = until_s + BOOT_S
        greeted = False
        while (line := self._next(until_s)) is not None:
            greeted = greeted or line.kind is Kind.RESET
            if greeted:
                until_s = min(clock.now_s() + TRAILING_S, latest_s)
        self._lines.clear()
        self._buffer.clear()

    def _ask(self, text: str, pattern: re.Pattern[str], *, expect_s: float) -> tuple[re.Match[str], list[str]]:
        output: list[str] = []
        for _ in range(ASKS):
            output = self._guarded(text, expect_s=expect_s, optional=False, awaited=pattern)
            for line in reversed(output):
                if found := pattern.search(line):
                    return found, output
        heard = repr(output[-1]) if output else "nothing"
        raise NoAnswerError(f"{self._name}: does not answer {text} as Marlin does ({heard}); check port, baud rate and cable")

    def _guarded(self, text: str, *, expect_s: float, optional: bool, awaited: re.Pattern[str] | None) -> list[str]:
        if self._lost is not None:
            raise LostError(self._lost)
        try:
            if self._unsettled_s is not None:
                self._settle(self._unsettled_s)
            return self._number_and_exchange(text, expect_s=expect_s, optional=optional, awaited=awaited)
        except LostError as error:
            self._lost = str(error)
            raise

    def _settle(self, expect_s: float) -> None:
        """Find a new beginning after a command that was broken off: the answers still to come must not be taken for those of the next."""
        self._number_and_exchange("M114", expect_s=expect_s, optional=False, awaited=POSITION)

    def _number_and_exchange(self, text: str, *, expect_s: float, optional: bool, awaited: re.Pattern[str] | None) -> list[str]:
        data = numbered(self._last + 1, text)
        self._drain()
        if optional:
            self._optional.add(text.split()[0])
        self._unsettled_s = max(expect_s, self._unsettled_s or 0.0)
        self._history[self._last + 1] = _Sent(text, data)
        self._last += 1
        self._history.pop(self._last - HISTORY, None)
        return self._exchange(expect_s=expect_s, awaited=awaited)

    def _exchange(self, *, expect_s: float, awaited: re.Pattern[str] | None) -> list[str]:
        """Send the last line of the history and see to it that the board takes it."""
        now_s = self._port.clock.now_s()
        state = _Exchange(number=self._last, expect_s=expect_s, awaited=awaited, quiet_s=now_s, end_s=now_s + LONGEST_S + 2.0 * expect_s)
        self._heard = 0
        self._send(state)
        for _ in range(MOST_LINES):
            if state.acknowledged and state.copies <= 0 and state.answered:
                break
            line = self._next(min(state.quiet_s, state.end_s))
            if line is None:
                if self._silence(state):
                    break
            else:
                self._hear(state, line)
        else:
            raise self._no_answer(state, "kept sending other things")
        self._unsettled_s = None
        if state.unknown is not None:
            raise RigError(
                f'{self._name}: the firmware does not know "{state.unknown}"; build Marlin 2.1 with the options that the docs list'
            )
        return state.output

    def _send(self, state: _Exchange, *, patience_s: float | None = None) -> None:
        if state.copies < MOST_COPIES:
            self._port.write(self._history[state.number].data)
            state.copies += 1
        state.waits = 0
        state.hinted = False
        state.quiet_s = self._port.clock.now_s() + (state.expect_s + ANSWER_S if patience_s is None else patience_s)

    def _silence(self, state: _Exchange) -> bool:
        """Deal with an answer that does not come; return whether the exchange is over."""
        if state.refused:
            self._refusal(state)
            return False
        if state.acknowledged:
            return True
        if self._port.clock.now_s() >= state.end_s:
            raise self._no_answer(state, "was busy without end")
        if state.hinted:
            state.hints += 1
            self._send(state)
            return False
        state.silences += 1
        if state.silences > MOST_SILENCES:
            raise self._no_answer(state, "did not answer")
        self._send(state, patience_s=AGAIN_S)
        return False

    def _hear(self, state: _Exchange, line: Line) -> None:
        now_s = self._port.clock.now_s()
        self._lost_if_reset(line)
        if line.kind is Kind.REFUSED and line.number is not None:
            state.refused = True
            state.wanted.add(line.number)
            state.quiet_s = now_s + TRAILING_S
        elif line.kind is Kind.OK:
            self._taken(state, line)
        elif line.kind is Kind.BUSY:
            if not state.refused:
                state.silences = 0
                state.quiet_s = now_s + BUSY_S
        elif line.kind is Kind.WAIT:
            state.waits += 1
            if state.waits == 2 and not state.refused:  # the first may have crossed our line; the second says that no ok will come
                state.quiet_s = now_s
        elif line.kind is Kind.UNKNOWN:
            self._unknown(state, line.text)
        elif line.kind is Kind.ERROR:
            state.doubtful = True
            state.output.append(line.text)
        else:
            state.output.append(line.text)
            if (line.kind is Kind.LIKE_OK or state.hinted) and state.hints < MOST_HINTS and not (state.acknowledged or state.refused):
                state.hinted = True
                state.quiet_s = now_s + TRAILING_S

    def _taken(self, state: _Exchange, line: Line) -> None:
        """Deal with an ``ok``."""
        now_s = self._port.clock.now_s()
        if state.refused:
            self._refusal(state)
        elif line.number is not None and line.number != state.number:  # ADVANCED_OK: that of another line, or damaged
            state.hinted = state.hints < MOST_HINTS
            state.quiet_s = min(state.quiet_s, now_s + TRAILING_S) if state.hinted else state.quiet_s
        elif state.doubtful:
            state.doubtful = False
            state.copies -= 1
            state.silences += 1
            if state.silences > MOST_SILENCES:
                raise self._no_answer(state, "answered with errors")
            self._send(state)
        elif state.number < self._last:
            state.number += 1
            state.copies = 0
            self._send(state)
        else:
            self._acknowledge(state)
            state.copies -= 1

    def _acknowledge(self, state: _Exchange) -> None:
        """Wait a little more, if answers to further copies, or what must be printed, have yet to come.

        What must be printed may take as long as the command: the ``ok`` may have been that of an earlier one.
        """
        state.acknowledged = True
        state.quiet_s = self._port.clock.now_s() + TRAILING_S + (0.0 if state.answered else state.expect_s)

    def _refusal(self, state: _Exchange) -> None:
        """Deal with a refusal that was read to its end: send what the board wants."""
        wanted = state.wanted.pop() if len(state.wanted) == 1 else None  # its two lines contradict each other: one is damaged
        state.wanted.clear()
        state.refused = state.doubtful = False
        state.copies -= 1
        if wanted == self._last + 1:
            if not state.acknowledged:
                state.copies -= 1  # answers come in order: the ok of the first copy was lost
            self._acknowledge(state)
            return
        if wanted == 1 and state.number > 1:
            raise self._was_reset("it counts its lines from the beginning")
        state.refusals += 1
        if state.refusals > MOST_REFUSALS:
            raise self._no_answer(state, f"refused it {MOST_REFUSALS} times")
        if wanted is not None and wanted in self._history and wanted <= self._last:
            if wanted != state.number:
                state.copies = 0
            state.number = wanted
        state.acknowledged = False
        self._send(state)

    def _unknown(self, state: _Exchange, quoted: str) -> None:
        """Deal with a command that the firmware does not know: one of ours, or one that became unknown on its way."""
        name = quoted.split()[0] if quoted.split() else ""
        if name in self._optional:
            return
        if any(sent.text.split()[0] == name for sent in self._history.values()):
            state.unknown = quoted
        else:
            state.doubtful = True

    def _drain(self) -> None:
        """Read what came since the last command: late and doubled answers, chatter, the greeting of a board that was reset."""
        self._heard = 0
        while (line := self._next(self._port.clock.now_s())) is not None:
            self._lost_if_reset(line)
        self._buffer.clear()

    def _lost_if_reset(self, line: Line) -> None:
        if line.kind is Kind.RESET:
            raise self._was_reset(f'it says "{line.text}"')
        if line.kind is Kind.HALTED:
            raise LostError(f'{self._name}: the board stopped itself ("{line.text}"); find out why, then switch it off and on')

    def _was_reset(self, why: str) -> LostError:
        return LostError(
            f"{self._name}: the board was reset ({why}), so that its angle is lost; check supply and cable, and find the angle anew"
        )

    def _no_answer(self, state: _Exchange, what: str) -> NoAnswerError:
        text = self._history[state.number].text
        heard = f" (last heard: {state.output[-1]!r})" if state.output else ""
        return NoAnswerError(f"{self._name}: {what} after {text}{heard}; check supply, cable, port and baud rate, then start again")

    def _next(self, until_s: float) -> Line | None:
        """Return the next line, or None when there is none up to this time."""
        while not self._lines:
            data = self._port.read(max(until_s - self._port.clock.now_s(), 0.0))
            if not data:
                return None
            self._heard += len(data)
            if self._heard > MOST_BYTES:
                raise NoAnswerError(f"{self._name}: sends without end and without sense; check baud rate and cable")
            self._buffer += data
            *whole, rest = self._buffer.split(b"\n")
            self._buffer = bytearray(rest)
            self._lines.extend(read_line(bytes(raw)) for raw in whole)
        return self._lines.popleft()
