"""A Marlin board of a few lines for the tests of its drivers, with faults on the wire; written from the protocol, not from the drivers."""

import hashlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import reduce
from operator import xor

import numpy as np
import pytest

from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.rig.scanning import markers
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.scenes.model import MarkerStrip
from tests.rig.fake_time import Time
from tests.rig.table.marlin_script import GREETING, LatePort, Script, Talk

Piece = tuple[float, bytes]
"""Delay in seconds, and bytes."""
Fault = Callable[[bytes], list[Piece]]
SPEED_DEG_PER_S = 30.0
COMMANDS = {"G1", "G90", "G92", *(f"M{code}" for code in (17, 18, 110, 113, 114, 115, 150, 154, 155, 204, 211, 400))}


@dataclass
class _Board(LatePort):
    """A board behind a port: the methods of `rig.serial_line.port.Port`, answers after Marlin 2.1."""

    greets: bool = False
    unknown: tuple[str, ...] = ()  # commands that this firmware does not have
    ok_after_resend: bool = True
    advanced_ok: bool = False
    keeps_alive: bool = True
    reply_faults: dict[int, Fault] = field(default_factory=dict)  # by the number of the line that the board prints, from 0
    request_faults: dict[int, Fault] = field(default_factory=dict)
    resets: dict[int, str] = field(default_factory=dict)  # at which request (from 0) the board starts anew first, and what it prints then
    x_deg: float = 0.0
    clock: Time = field(default_factory=Time)

    def __post_init__(self) -> None:
        self.last = 0
        self.done_s = 0.0  # of all moves
        self.free_s = 0.0  # of the command that blocks
        self.moves: list[float] = []
        self.energised = False
        self.strips: dict[int, dict[str, int]] = {0: {}, 1: {}}
        self.done: list[str] = []  # commands that were carried out
        self.sent: list[bytes] = []
        self.waiting: list[Piece] = []
        self.partial = b""
        self.printed = 0
        self.closed = 0
        if self.greets:
            self.put("start\nPowerUp\nMarlin 2.1.2.5\necho: Last Updated: 2024-12-02\n", 1.0)

    def write(self, data: bytes) -> None:
        number = len(self.sent)
        self.sent.append(data)
        if number in self.resets:
            self.reset(self.resets[number])
        for _, piece in self.request_faults.get(number, lambda data: [(0.0, data)])(data):
            *whole, self.partial = (self.partial + piece).split(b"\n")
            for text in whole:
                self.take(text.decode("latin-1").strip())

    def discard_input(self) -> None:
        list(iter(lambda: self.read(0.0), b""))

    def close(self) -> None:
        self.closed += 1

    def reset(self, banner: str) -> None:
        self.last, self.x_deg, self.energised, self.partial = 0, 0.0, False, b""
        self.done_s = self.free_s = self.clock.at_s
        self.strips = {0: {}, 1: {}}
        self.waiting.clear()
        self.put(banner, 0.3)

    def put(self, text: str, delay_s: float = 0.001) -> None:
        for text_line in text.splitlines(keepends=True):
            fault = self.reply_faults.get(self.printed, lambda data: [(0.0, data)])
            self.printed += 1
            for later_s, data in fault(text_line.encode("latin-1")):
                if data:
                    self.waiting.append((max(self.clock.at_s, self.free_s) + delay_s + later_s, data))

    def take(self, text: str) -> None:
        if not text:
            return None
        number: int | None = None
        if text.startswith("N"):
            body, star, checksum = text.partition("*")
            number = int(found[0]) if (found := re.match(r"\d+", text[1:])) else -1
            if " M110" not in text and number != self.last + 1:
                return self.refuse("Line Number is not Last Line Number+1")
            if not star:
                return self.refuse("No Checksum with line number")
            if str(reduce(xor, body.encode("latin-1"))) != checksum:
                return self.refuse("checksum mismatch")
            self.last = number
            text = body.partition(" ")[2]
        ok = f"ok N{number} P15 B3\n" if self.advanced_ok and number is not None else "ok\n"
        self.carry_out(text, ok)
        return None

    def refuse(self, why: str) -> None:
        self.put(f"Error:{why}, Last Line: {self.last}\nResend: {self.last + 1}\n" + "ok\n" * self.ok_after_resend)

    def carry_out(self, text: str, ok: str) -> None:
        name, *words = text.split()
        values = {word[0]: float(found[0]) if (found := re.match(r"-?[\d.]+", word[1:])) else 0.0 for word in words}
        now_s = max(self.clock.at_s, self.free_s)
        if name in self.unknown or name not in COMMANDS:
            self.put(f'echo:Unknown command: "{text}"\n{ok}')
            return
        self.done.append(text)
        if name == "G1" and "X" in values:
            self.done_s = max(self.done_s, now_s) + abs(values["X"] - self.x_deg) / SPEED_DEG_PER_S
            self.x_deg = values["X"]
            self.moves.append(self.x_deg)
        elif name == "M400":
            busy_s = now_s + 2.0
            while busy_s < self.done_s and self.keeps_alive:
                self.waiting.append((busy_s, b"echo:busy: processing\n"))
                busy_s += 2.0
            self.free_s = max(self.done_s, now_s)
        elif name == "G92":
            self.x_deg = values["X"]
        elif name in ("M17", "M18") and "S" not in values:
            self.energised = name == "M17"
        elif name == "M150":
            self.strips[int(values["S"])] = {letter: int(value) for letter, value in values.items() if letter != "S"}
        elif name == "M114":
            self.put(f"X:{self.x_deg:.2f} Y:0.00 Z:0.00 E:0.00 Count X:{round(self.x_deg * 160 / 9)} Y:0 Z:0\n")
        elif name == "M115":
            self.put(
                "FIRMWARE_NAME:Marlin 2.1.2.5 (Dec  2 2024 12:00:00) SOURCE_CODE_URL:github.com/x PROTOCOL_VERSION:1.0\n"
                "Cap:EEPROM:0\nCap:EMERGENCY_PARSER:1\n"
            )
        self.put(ok)

    @property
    def at_rest(self) -> bool:
        return self.clock.at_s >= self.done_s


@pytest.fixture(scope="session", autouse=True)
def markers_found_once() -> Iterator[None]:
    """Look for markers once in equal pictures: that is most of the time of a scan on fakes, whose pictures recur."""
    found = dict[tuple[object, ...], Markers]()

    def detect(image: np.ndarray, strip: MarkerStrip, *, measure: bool = True) -> Markers:
        key = (hashlib.sha256(image.tobytes()).digest(), image.dtype, image.shape, strip, measure)
        if key not in found:
            found[key] = detect_markers(image, strip, measure=measure)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(markers, "detect_markers", detect)
        yield


@pytest.fixture
def board() -> _Board:
    return _Board()


@pytest.fixture(scope="session")
def make_board() -> type[_Board]:
    return _Board


@pytest.fixture
def talk(make_board: Callable[..., _Board]) -> Talk:
    """Return a link that was started on a script."""
    script = Script(make_board().clock, *GREETING)
    link = MarlinLink(script)
    link.start()
    assert not script.steps
    script.clock.at_s = 0.0
    return Talk(script, link)
