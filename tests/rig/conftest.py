"""The twin's board with faults on the wire, for the tests of its drivers."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.rig.scanning import markers
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.twin.adapter import Reply
from rhizotwin.rig.twin.imperfections import CLEAN
from rhizotwin.rig.twin.marlin_adapter import MarlinAdapter
from rhizotwin.rig.twin.stepper import Stepper
from rhizotwin.scenes.model import MarkerStrip
from tests.rig.fake_time import Time
from tests.rig.table.marlin_script import GREETING, LatePort, Script, Talk

Piece = tuple[float, bytes]
"""Delay in seconds, and bytes."""
Fault = Callable[[bytes], list[Piece]]


def _whole(data: bytes) -> list[Piece]:
    return [(0.0, data)]


class _Lamp(dict[str, int]):
    """A strip that keeps its last colour and brightness."""

    def show(self, rgb: tuple[int, int, int], *, led: int | None = None) -> None:
        assert led is None
        self.update(zip("RUB", rgb, strict=True))

    def dim(self, brightness: int) -> None:
        self["P"] = brightness

    power_up = dict.clear


@dataclass
class _Board(LatePort):
    """The twin's board behind a port (the methods of `rig.serial_line.port.Port`), with faults at numbered lines."""

    greets: bool = False
    unknown: tuple[str, ...] = ()  # commands that this firmware does not have
    ok_after_resend: bool = True
    advanced_ok: bool = False
    keeps_alive: bool = True
    reply_faults: dict[int, Fault] = field(default_factory=dict)  # by the number of the line that the board prints, from 0
    request_faults: dict[int, Fault] = field(default_factory=dict)
    resets: dict[int, str] = field(default_factory=dict)  # at which request (from 0) the board starts anew first, and whether it says so
    start_deg: float = 0.0
    clock: Time = field(default_factory=Time)

    def __post_init__(self) -> None:
        self.motor = Stepper(full_step_deg=1.8, imperfections=CLEAN, key=(0, 2))
        self.strips = {0: _Lamp(), 1: _Lamp()}
        self.adapter = MarlinAdapter(self.motor, tuple(self.strips.values()), ok_after_resend=self.ok_after_resend)
        self.adapter.commands.do("G92", {"X": self.start_deg}, 0.0)
        self.command, self.adapter._command = self.adapter._command, self.carry_out
        self.moves: list[float] = []
        self.done: list[str] = []  # commands that were carried out
        self.sent: list[bytes] = []
        self.waiting: list[Piece] = []
        self.printed = 0
        self.pumped_s = 0.0
        if self.greets:
            self.adapter.reset(0.0)

    def carry_out(self, line: str, now_s: float) -> list[str]:
        name, *words = line.split()
        if name in self.unknown:
            return [f'echo:Unknown command: "{line}"', "ok"]
        self.done.append(line)
        self.moves += [float(word[1:]) for word in words if name == "G1" and word[0] == "X"]
        return self.command(line, now_s)

    def write(self, data: bytes) -> None:
        self.pump(self.clock.at_s)
        number = len(self.sent)
        self.sent.append(data)
        if number in self.resets:
            self.reset(self.resets[number])
        for _, piece in self.request_faults.get(number, _whole)(data):
            self.say(self.adapter.receive(piece, self.clock.at_s))

    def read(self, timeout_s: float) -> bytes:
        until_s = self.clock.at_s + timeout_s
        while self.adapter.next_s() <= min([until_s, *(due_s for due_s, _ in self.waiting)]):
            self.pump(self.adapter.next_s())
        data = super().read(timeout_s)
        self.pump(self.clock.at_s)
        return data

    def discard_input(self) -> None:
        list(iter(lambda: self.read(0.0), b""))

    def reset(self, banner: str) -> None:
        """Reset the board, which greets or, without a banner, says nothing."""
        self.waiting.clear()
        self.adapter.reset(self.clock.at_s)
        if not banner:
            self.adapter._boot_s = None

    def pump(self, until_s: float) -> None:
        """Let time pass on the board."""
        while self.pumped_s < until_s or self.adapter.next_s() <= until_s:
            now_s = max(min(self.adapter.next_s(), until_s), self.pumped_s)
            self.motor.advance(now_s - self.pumped_s)
            self.pumped_s = now_s
            self.say(self.adapter.poll(now_s))

    def say(self, replies: list[Reply]) -> None:
        for reply in replies:
            data = reply.data
            if data.startswith(b"echo:busy") and not self.keeps_alive:
                continue
            if data == b"ok\n" and self.advanced_ok:
                data = b"ok N%d P15 B3\n" % self.adapter._last
            fault = self.reply_faults.get(self.printed, _whole)
            self.printed += 1
            self.waiting += [(reply.due_s + later_s, piece) for later_s, piece in fault(data) if piece]

    @property
    def x_deg(self) -> float:
        return self.adapter.commands._goal_deg


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
def talk() -> Talk:
    """Return a link that was started on a script."""
    script = Script(Time(), *GREETING)
    link = MarlinLink(script)
    link.start()
    assert not script.steps
    script.clock.at_s = 0.0
    return Talk(script, link)
