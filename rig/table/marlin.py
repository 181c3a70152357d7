"""The link to a Marlin board.

Numbered, checksummed lines, one in flight, each sent again until it is certain that the board took it.

The board takes lines only in the order of their numbers, so a line that is sent twice is done once: the second copy is
refused, and the number that the refusal asks for proves that the first was taken. Whatever happens to an answer is
cured in this way. What cannot be seen from a single answer is an ``ok`` that belongs to an earlier line (late, or
doubled). Therefore nothing is believed to be done until a command that prints something, asked after it, has printed
it: see `MarlinLink.ask`.
"""

import re

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Wire
from rhizotwin.rig.table.marlin_exchange import BUSY_EVERY_S, TRAILING_S, Exchange, Journal
from rhizotwin.rig.table.marlin_lines import CAPABILITY, FIRMWARE, POSITION, Kind
from rhizotwin.rig.table.marlin_wire import MarlinWire

BOOT_S = 3.0
"""Boards that start anew when their port is opened greet within this time; others say nothing."""
STARTS = 3
ASKS = 3


class MarlinLink:
    """The board behind a port. Turntable and lights share one."""

    def __init__(self, port: Wire) -> None:
        self._wire = MarlinWire(port)
        self._journal = Journal()
        # how long the command may take that was broken off, by Ctrl-C or for want of an answer
        self._unsettled_s: float | None = None
        self._lost: str | None = f"{self._wire.name}: not connected yet"
        self.firmware = ""
        """What M115 says, such as "Marlin 2.1.2.5 (Dec  2 2024 12:00:00)"."""
        self.capabilities: frozenset[str] = frozenset()
        self.sessions = 0
        """How often the link was started: what was known of the board before is to be asked again."""

    @property
    def name(self) -> str:
        """Device and port, for messages."""
        return self._wire.name

    @property
    def ready(self) -> bool:
        """Whether the link was started and the board was not lost since."""
        return self._lost is None

    def start(self) -> None:
        """Agree on line numbers, ask for the firmware, switch off what it would do by itself.

        Table and lights are left as they are.

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

        That it was taken does not mean that it is done: moves are only queued, and an ``ok`` may have belonged to an
        earlier command. Whoever needs to know goes on with `ask`.

        Parameters
        ----------
        text : str
            Without number and checksum.
        expect_s : float
            How long the board may need until its ``ok``.
        optional : bool
            Whether a firmware that does not know the command will do.

        Returns
        -------
        list of str
            Its lines before ``ok``.

        Raises
        ------
        NoAnswerError
            When the board did not take it after every retry; the link may be used on.
        LostError
            When the board was reset, halted or unplugged, now or since the last `start`.
        RigError
            When the firmware does not support the command.
        """
        return self._guarded(text, expect_s=expect_s, optional=optional, awaited=None)

    def ask(self, text: str, pattern: re.Pattern[str], *, expect_s: float = 0.0) -> re.Match[str]:
        """Have a command answered.

        The board works in order: everything sent before is done then (moves: if M400 was sent behind them).

        Parameters
        ----------
        text : str
            The command.
        pattern : Pattern[str]
            Searched for in each line of the answer. It must refuse lines that were cut short; a digit may still be
            wrong.
        expect_s : float
            How long it may take.

        Returns
        -------
        re.Match[str]
            The line that answers.

        Raises
        ------
        NoAnswerError, LostError, RigError
            As `command`; and when the answers cannot be understood.
        """
        return self._ask(text, pattern, expect_s=expect_s)[0]

    def send_unheard(self, *texts: str) -> None:
        """Send commands to a board that may hear though it is not heard.

        Three times, unnumbered, so that lost lines do no harm.
        """
        for text in texts * 3:
            self._wire.send(text.encode() + b"\n")
        self._unsettled_s = self._unsettled_s or 0.0

    def quick_stop(self) -> bool:
        """Stop a move at once, where the firmware can (EMERGENCY_PARSER); return whether it can.

        The table's angle is forgotten.
        """
        if "EMERGENCY_PARSER" not in self.capabilities or not self.ready:
            return False
        try:
            self._wire.send(b"M410\n")  # acts as it is received, whatever waits before it
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
        self._lost = f"{self._wire.name}: closed"
        self._wire.close()

    def _greet(self) -> None:
        self._listen_to_greeting()
        self._journal = Journal()
        self._unsettled_s = None
        Exchange(self._wire, self._journal, expect_s=0.0, awaited=None).run()
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
        clock = self._wire.clock
        self._wire.fresh()
        until_s = clock.now_s() + BOOT_S
        latest_s = until_s + BOOT_S
        greeted = False
        while (line := self._wire.next(until_s)) is not None:
            greeted = greeted or line.kind is Kind.RESET
            if greeted:
                until_s = min(clock.now_s() + TRAILING_S, latest_s)
        self._wire.forget()

    def _ask(self, text: str, pattern: re.Pattern[str], *, expect_s: float) -> tuple[re.Match[str], list[str]]:
        output: list[str] = []
        for _ in range(ASKS):
            output = self._guarded(text, expect_s=expect_s, optional=False, awaited=pattern)
            for line in reversed(output):
                if found := pattern.search(line):
                    return found, output
        heard = repr(output[-1]) if output else "nothing"
        raise NoAnswerError(f"{self._wire.name}: does not reply to {text} like Marlin ({heard}); check port, baud rate and cable")

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
        """Find a new beginning after a command that was broken off.

        The answers still to come must not be taken for those of the next.
        """
        self._number_and_exchange("M114", expect_s=expect_s, optional=False, awaited=POSITION)

    def _number_and_exchange(self, text: str, *, expect_s: float, optional: bool, awaited: re.Pattern[str] | None) -> list[str]:
        self._wire.drain()
        self._unsettled_s = max(expect_s, self._unsettled_s or 0.0)
        self._journal.add(text, optional=optional)
        exchange = Exchange(self._wire, self._journal, expect_s=expect_s, awaited=awaited)
        output = exchange.run()
        self._unsettled_s = None
        exchange.check_known()
        return output
