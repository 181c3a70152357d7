"""Link to a Marlin board.

The link sends numbered lines with checksums one at a time, and repeats them until they are received. The board accepts
lines only in the order of their numbers, so that a repeated line is executed only once. The board rejects the second
copy, and the number requested in the rejection confirms that the first copy was received. This handles every loss of a
reply. However, a single reply cannot show whether an ``ok`` refers to an earlier line (because it is late or
duplicated). Therefore commands count as executed only after the board has replied to a subsequent command that prints
output, see `MarlinLink.ask`.
"""

import re

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.serial_line.port import Wire
from rhizotwin.rig.table.marlin_exchange import BUSY_EVERY_S, TRAILING_S, Exchange, Journal
from rhizotwin.rig.table.marlin_lines import FIRMWARE, POSITION, Kind
from rhizotwin.rig.table.marlin_wire import MarlinWire

BOOT_S = 3.0
"""Maximum delay between the opening of the port and the first line of the board's greeting, s. Only boards that reset
when the port is opened send a greeting."""
STARTS = 3
ASKS = 3


class MarlinLink:
    """Link to a Marlin board, shared by the turntable and the lights."""

    def __init__(self, port: Wire) -> None:
        self._wire = MarlinWire(port)
        self._journal = Journal()
        # maximum remaining duration of an interrupted command, or of a command without reply
        self._unsettled_s: float | None = None
        self._lost: str | None = f"{self._wire.name}: not connected yet"
        self.firmware = ""
        """Firmware reported by M115, such as "Marlin 2.1.2.5 (Dec  2 2024 12:00:00)"."""
        self.sessions = 0
        """Number of times the link was started. The board may have been reset between two starts, so that its state has
        to be read again."""

    @property
    def name(self) -> str:
        """Name of device and port, used in messages."""
        return self._wire.name

    @property
    def ready(self) -> bool:
        """Return whether the link was started and the connection was not lost afterwards."""
        return self._lost is None

    def start(self) -> None:
        """Synchronise line numbers, query the firmware, and switch off its automatic reports.

        The table and the lights do not change.

        Raises
        ------
        NoAnswerError
            If there is no reply, or the reply is invalid.
        RigError
            If the board runs other firmware, which is named.
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
        """Send a command repeatedly until it is received, and return the lines printed by the board.

        A received command has not necessarily been executed, because moves are only queued, and an ``ok`` may refer to
        an earlier command. Use `ask` to verify the execution.

        Parameters
        ----------
        text : str
            Command without number and checksum.
        expect_s : float
            Maximum time until the board sends ``ok``, s.
        optional : bool
            Whether the firmware is permitted not to support the command.

        Returns
        -------
        list of str
            Lines printed before ``ok``.

        Raises
        ------
        NoAnswerError
            If the board did not receive the command after all retries. The link remains usable.
        LostError
            If the board was reset, halted or unplugged, now or since the last `start`.
        RigError
            If the firmware does not support the command.
        """
        return self._exchange_guarded(text, expect_s=expect_s, optional=optional, awaited=None)

    def ask(self, text: str, pattern: re.Pattern[str], *, expect_s: float = 0.0) -> re.Match[str]:
        """Send a command, and return the match of a pattern in the board's reply.

        Since the board executes commands in order, all previous commands are complete. Moves are an exception, because
        they are queued. They are complete only if M400 was sent after them.

        Parameters
        ----------
        text : str
            Command without number and checksum.
        pattern : Pattern[str]
            Pattern searched for in each line of the reply. It must not match truncated lines, but a digit may still be
            wrong.
        expect_s : float
            Maximum duration of the command, s.

        Returns
        -------
        re.Match[str]
            Match in a line of the reply.

        Raises
        ------
        NoAnswerError, LostError, RigError
            See `command`; also if the replies are invalid.
        """
        output: list[str] = []
        for _ in range(ASKS):
            output = self._exchange_guarded(text, expect_s=expect_s, optional=False, awaited=pattern)
            for line in reversed(output):
                if found := pattern.search(line):
                    return found
        heard = repr(output[-1]) if output else "nothing"
        raise NoAnswerError(
            f"{self._wire.name}: the reply to {text} is not that of a Marlin board ({heard}); check port, baud rate, cable and firmware"
        )

    def send_unheard(self, *texts: str) -> None:
        """Send commands to a board whose replies cannot be received.

        Each command is sent three times without a line number, so that the loss of a line has no effect.
        """
        for text in texts * 3:
            self._wire.send(text.encode() + b"\n")
        self._unsettled_s = self._unsettled_s or 0.0

    def close(self) -> None:
        """Close the port.

        If it is already closed, nothing happens.
        """
        self._lost = f"{self._wire.name}: closed"
        self._wire.close()

    def _greet(self) -> None:
        self._listen_to_greeting()
        self._journal = Journal()
        self._unsettled_s = None
        Exchange(self._wire, self._journal, expect_s=0.0, awaited=None).run()
        self._lost = None
        self.firmware = self._ask_firmware()
        self.sessions += 1
        self.command(f"M113 S{BUSY_EVERY_S}", optional=True)
        for reports in ("M155 S0", "M154 S0"):  # unsolicited reports would interfere with the replies
            self.command(reports, optional=True)
        self.command("M211 S0", optional=True)  # software endstops
        self.command("M18 S0")  # otherwise the idle motor is released, and the table angle lost
        self.ask("M114", POSITION)

    def _ask_firmware(self) -> str:
        """Return the name of the firmware.

        A name other than Marlin may be damaged, so that it is queried again.
        """
        name = ""
        for _ in range(ASKS):
            name = " ".join(filter(None, self.ask("M115", FIRMWARE).groups()))
            if re.match(r"Marlin\b", name):
                return name
        raise self._wire.other_firmware(name)

    def _listen_to_greeting(self) -> None:
        """Wait until a starting board has sent its greeting.

        If the board is already running, wait for the timeout.
        """
        clock = self._wire.clock
        self._wire.reset_count()
        until_s = clock.now_s() + BOOT_S
        latest_s = until_s + BOOT_S
        greeted = False
        while (line := self._wire.next(until_s)) is not None:
            if line.kind is Kind.FOREIGN:
                self._wire.check(line)
            greeted = greeted or line.kind is Kind.RESET
            if greeted:
                until_s = min(clock.now_s() + TRAILING_S, latest_s)
        self._wire.forget()

    def _exchange_guarded(self, text: str, *, expect_s: float, optional: bool, awaited: re.Pattern[str] | None) -> list[str]:
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
        """Request the position, so that all replies to an interrupted command are received.

        Otherwise late replies could be attributed to the next command.
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
