"""Connection to a Marlin board.

Lines are numbered and have checksums. One line is sent at a time, and repeated until the board has certainly accepted
it.

The board accepts lines only in the order of their numbers, so that a repeated line is executed once: the second copy is
refused, and the number in the refusal proves that the first was accepted. This covers all losses of replies. A single
reply does not show whether an ``ok`` belongs to an earlier line (late or duplicated). A command therefore counts as
done only after a later command with printed output has been answered: see `MarlinLink.ask`.
"""

import re

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Wire
from rhizotwin.rig.table.marlin_exchange import BUSY_EVERY_S, TRAILING_S, Exchange, Journal
from rhizotwin.rig.table.marlin_lines import CAPABILITY, FIRMWARE, POSITION, Kind
from rhizotwin.rig.table.marlin_wire import MarlinWire

BOOT_S = 3.0
"""Boards that reset when their port is opened send a greeting within this time; others send nothing."""
STARTS = 3
ASKS = 3


class MarlinLink:
    """Board behind a port, shared by turntable and lamps."""

    def __init__(self, port: Wire) -> None:
        self._wire = MarlinWire(port)
        self._journal = Journal()
        # possible duration of a command that was aborted, by Ctrl-C or a missing reply
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
        """Whether the connection was started and the board was not lost since."""
        return self._lost is None

    def start(self) -> None:
        """Synchronise line numbers, read the firmware version, and disable automatic functions.

        Turntable and lamps are not changed.

        Raises
        ------
        NoAnswerError
            If nothing replies, or the reply is not from Marlin.
        LostError
            If the board resets repeatedly, is halted, or was unplugged.
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
        """Send a command until it is accepted; return the lines printed by the board meanwhile.

        Acceptance does not mean completion: moves are queued, and an ``ok`` may belong to an earlier command. To wait
        for completion, use `ask` afterwards.

        Parameters
        ----------
        text : str
            Command without number and checksum.
        expect_s : float
            Maximum expected time until ``ok``.
        optional : bool
            Whether the firmware may lack the command.

        Returns
        -------
        list of str
            Lines before ``ok``.

        Raises
        ------
        NoAnswerError
            If the board did not accept the command after all retries; the connection remains usable.
        LostError
            If the board was reset, halted or unplugged since the last `start`.
        RigError
            If the firmware does not support the command.
        """
        return self._guarded(text, expect_s=expect_s, optional=optional, awaited=None)

    def ask(self, text: str, pattern: re.Pattern[str], *, expect_s: float = 0.0) -> re.Match[str]:
        """Send a command and return its reply.

        The board processes commands in order: all earlier commands are done then (moves: if M400 was sent after them).

        Parameters
        ----------
        text : str
            Command.
        pattern : Pattern[str]
            Pattern searched in each line of the reply. It must not match truncated lines; a digit may still be wrong.
        expect_s : float
            Maximum expected time.

        Returns
        -------
        re.Match[str]
            Matching line.

        Raises
        ------
        NoAnswerError, LostError, RigError
            As `command`; and if the replies are invalid.
        """
        return self._ask(text, pattern, expect_s=expect_s)[0]

    def send_unheard(self, *texts: str) -> None:
        """Send commands to a board whose replies may be lost.

        They are sent three times, without numbers, so that lost lines do no harm.
        """
        for text in texts * 3:
            self._wire.send(text.encode() + b"\n")
        self._unsettled_s = self._unsettled_s or 0.0

    def quick_stop(self) -> bool:
        """Stop a move at once if the firmware supports it (EMERGENCY_PARSER); return whether it does.

        The angle of the turntable is lost.
        """
        if "EMERGENCY_PARSER" not in self.capabilities or not self.ready:
            return False
        try:
            self._wire.send(b"M410\n")  # processed on reception, before all queued commands
        except LostError as error:
            self._lost = str(error)
            raise
        self._unsettled_s = self._unsettled_s or 0.0
        self.sessions += 1
        self.command("G92 X0")
        self.ask("M114", POSITION)
        return True

    def close(self) -> None:
        """Close the port, if it is open."""
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
        for reports in ("M155 S0", "M154 S0"):  # these would interfere with the replies
            self.command(reports, optional=True)
        self.command("M211 S0", optional=True)  # software endstops
        self.command("M18 S0")  # otherwise the idle motor is released and the angle is lost
        self.ask("M114", POSITION)

    def _listen_to_greeting(self) -> None:
        """Wait for the end of the greeting of a starting board, or for silence of a running one."""
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
        """Resynchronise after an aborted command.

        Pending replies must not be mistaken for those of the next command.
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
