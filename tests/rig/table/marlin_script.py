"""A Marlin board that demands lines in their order and answers each, for the tests of the link to it."""

from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Any

from rhizotwin.rig.table.marlin import MarlinLink

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


class LatePort:
    """A port with input under way: what arrives, by its time."""

    url = "fake"
    device = "turntable"
    clock: Any
    waiting: list[tuple[float, bytes]]

    def read(self, timeout_s: float) -> bytes:
        """Hand out what arrives next within the time-out."""
        self.waiting.sort(key=lambda piece: piece[0])
        if not self.waiting or self.waiting[0][0] > self.clock.now_s() + timeout_s:
            self.clock.sleep(timeout_s)
            return b""
        due_s, data = self.waiting.pop(0)
        self.clock.sleep(due_s - self.clock.now_s())
        return data


class Script(LatePort):
    """A port that demands lines in their order and answers each; an answer with a number is that many seconds late."""

    def __init__(self, clock: Any, *steps: tuple[str, tuple[Any, ...]]) -> None:
        self.clock = clock
        self.steps = list(steps)
        self.waiting: list[tuple[float, bytes]] = []
        self.interrupt = False
        self.sent_s: list[float] = []

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
        self.sent_s.append(self.clock.now_s())
        wanted, answers = self.steps.pop(0)
        assert data == f"{wanted}*{reduce(xor, wanted.encode())}\n".encode()
        self.answer(*answers)

    def read(self, timeout_s: float) -> bytes:
        """Hand out the next answer, or press Ctrl-C once."""
        if self.interrupt and timeout_s > 0.0:
            self.interrupt = False
            raise KeyboardInterrupt
        return super().read(timeout_s)

    def discard_input(self) -> None:
        """Refuse: what is dropped must have been read."""
        raise AssertionError("the link reads what it drops")


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
