"""Line protocol of Marlin 2.1.

The adapter implements line numbers, checksums, resends, sequential execution, busy lines, reset and kill. It does not
model the physics, and follows queue.cpp, e_parser.h, language.h and setup() of Marlin. The commands are implemented in
`rig.twin.marlin_commands`.
"""

import math
import re
from collections import deque

from rhizotwin.rig.twin.adapter import Motor, Reply, Strip
from rhizotwin.rig.twin.marlin_commands import VERSION, MarlinCommands

THINKING_S = 0.001
"""Delay between a line and its reply, s."""
BOOT_S = 0.3
"""Delay between a reset and the first line of the greeting, s."""
BUSY_EVERY_S = 2.0
MAX_LINE = 96
BANNER = (
    "start",
    " {reason}",
    f"Marlin {VERSION}",
    "echo: Last Updated: 2024-12-02 | Author: (rhizotwin twin)",
    "echo: Free Memory: 3757  PlannerBufferBytes: 1232",
    "echo:Hardcoded Default Settings Loaded",
)
_WORD = re.compile(r"([A-Z])\s*([-+]?\d*\.?\d*)")
_EMERGENCY = re.compile(r"(?:N\s*\d+\s*)?(M112|M410|M108)(?!\d)")


class MarlinAdapter:
    """Emulated board with Marlin firmware.

    Parameters
    ----------
    motor
        Motor that is driven as axis X.
    strips
        LED strips 0 and 1.
    outputs_on
        Set of fan outputs that are on, which is updated; None if there are no outputs.
    ok_after_resend
        Whether ``Resend:`` is followed by ``ok``. Some 2.0.x versions omit it.
    """

    def __init__(
        self, motor: Motor, strips: tuple[Strip, Strip], *, outputs_on: set[int] | None = None, ok_after_resend: bool = True
    ) -> None:
        self._motor = motor
        self._outputs_on = set() if outputs_on is None else outputs_on
        self._strips = strips
        self._ok_after_resend = ok_after_resend
        self._start_anew()

    def _start_anew(self) -> None:
        self.commands = MarlinCommands(self._motor, self._strips, self._outputs_on)
        self.halted = False
        self._partial = bytearray()
        self._lines: deque[str] = deque()
        self._last = 0
        self._busy_every_s = BUSY_EVERY_S
        self._next_busy_s = math.inf
        self._done_s: float | None = None  # time at which the blocking command is complete
        self._boot_s: float | None = None  # time of the banner
        self._boot_reason = ""

    def reset(self, now_s: float, *, reason: str = "External Reset") -> None:
        """Reset the board as its reset button does.

        The state is lost, and the greeting follows.
        """
        self._start_anew()
        self.commands.power_up()
        self._boot_s, self._boot_reason = now_s + BOOT_S, reason

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Receive bytes from the host, and return the replies.

        Bytes are lost while the board starts and after it was killed.
        """
        if self._boot_s is not None or self.halted:
            return []
        replies: list[Reply] = []
        for byte in data:
            if byte not in b"\r\n":
                if len(self._partial) < MAX_LINE:
                    self._partial.append(byte)
                continue
            line = self._partial.decode("latin-1").split(";")[0].strip()
            self._partial.clear()
            if line:
                replies += self._emergency(line, now_s)
                self._lines.append(line)
        return replies + self._work(now_s)

    def next_s(self) -> float:
        """Return the time of the board's next output or action, s.

        It is infinity if none is scheduled.
        """
        if self.halted:
            return math.inf
        if self._boot_s is not None:
            return self._boot_s
        return min(math.inf if self._done_s is None else self._done_s, self._next_busy_s, self.commands.next_s())

    def poll(self, now_s: float) -> list[Reply]:
        """Return the greeting, busy lines and late replies that are due, and switch off a motor that was idle."""
        if self.halted or now_s < self.next_s():
            return []
        if self._boot_s is not None:
            self._boot_s = None
            return _replies([line.format(reason=self._boot_reason) for line in BANNER], now_s)
        replies = self._work(now_s)
        if now_s >= self._next_busy_s:
            replies += _replies(["echo:busy: processing"], now_s)
            self._next_busy_s += self._busy_every_s
        self.commands.poll(now_s)
        return replies

    def _work(self, now_s: float) -> list[Reply]:
        """Execute waiting lines until a command blocks the following lines."""
        replies: list[Reply] = []
        while not self.halted:
            if self._done_s is not None:
                if now_s < self._done_s:
                    break
                self._done_s, self._next_busy_s = None, math.inf
                replies += _replies(["ok"], now_s)
            if not self._lines:
                break
            replies += _replies(self._line(self._lines.popleft(), now_s), now_s + THINKING_S)
        return replies

    def _line(self, line: str, now_s: float) -> list[str]:
        """Check the number and the checksum of a line, execute its command, and return the lines of the reply."""
        if line.startswith("N"):
            renumber = line.find("M110")
            second = line.find("N", renumber) if renumber >= 0 else -1  # the last N in the line counts
            number = _whole(line[max(second, 0) + 1 :])
            if renumber < 0 and number != self._last + 1:
                return self._resend("Line Number is not Last Line Number+1")
            body, star, checksum = line.rpartition("*")
            if not star:
                return self._resend("No Checksum with line number")
            if _whole(checksum) != _xor(body):
                return self._resend("checksum mismatch")
            self._last = number
            line = re.sub(r"^N\s*[-+]?\d+\s*", "", body)
        elif "*" in line:  # Marlin 2 does not verify the checksum of a line without a number
            line = line.rpartition("*")[0]
        return self._command(line.strip(), now_s)

    def _resend(self, why: str) -> list[str]:
        self._lines.clear()  # the receive buffer is flushed
        return [f"Error:{why}, Last Line: {self._last}", f"Resend: {self._last + 1}", *(["ok"] if self._ok_after_resend else [])]

    def _command(self, line: str, now_s: float) -> list[str]:
        found = re.match(r"([GM])\s*(\d+)", line)
        name = f"{found[1]}{int(found[2])}" if found else ""
        words = {letter: _number(text) for letter, text in _WORD.findall(line[found.end() :])} if found else {}
        if name == "M105":
            return ["ok T:0.00 /0.00 @:0"]
        if name == "M110":
            self._last = int(words.get("N") or 0) if "N" in words else self._last
            return ["ok"]
        if name == "M113":
            every_s = words.get("S")
            self._busy_every_s = self._busy_every_s if every_s is None else every_s
            return ["ok"] if "S" in words else [f"echo:M113 S{self._busy_every_s:g}", "ok"]
        answer = self.commands.do(name, words, now_s)
        if answer is None:
            return [f'echo:Unknown command: "{line}"', "ok"]
        if answer.wait_s > 0.0:
            self._done_s = now_s + answer.wait_s + THINKING_S
            self._next_busy_s = now_s + self._busy_every_s if self._busy_every_s > 0.0 else math.inf
            return list(answer.texts)
        return [*answer.texts, "ok"]

    def _emergency(self, line: str, now_s: float) -> list[Reply]:
        """Execute M112, M410 and M108 as soon as they are received, even if other commands are queued."""
        found = _EMERGENCY.match(line)
        if found is None:
            return []
        if found[1] == "M112":
            self.commands.kill()
            self.halted = True
            return _replies(["echo:M112 Shutdown", "Error:Printer halted. kill() called!"], now_s + THINKING_S)
        if found[1] == "M410":
            self.commands.quick_stop()
        if self._done_s is not None:
            self._done_s = now_s
        return []


def _replies(texts: list[str], due_s: float) -> list[Reply]:
    return [Reply(due_s, f"{text}\n".encode("latin-1")) for text in texts]


def _xor(text: str) -> int:
    checksum = 0
    for byte in text.encode("latin-1"):
        checksum ^= byte
    return checksum


def _whole(text: str) -> int:
    """Return the integer at the beginning of a text, as the C function strtol does."""
    found = re.match(r"\s*([-+]?\d+)", text)
    return int(found[1]) if found else 0


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
