"""The thesis's hat, driven through libraries of the same names that emulate a DRV8825 and two strips."""

import sys
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from rhizotwin.rig.errors import LostError, RigError, UnsafeError
from rhizotwin.rig.open import open_board
from rhizotwin.rig.rig_file import BandPart, HatPart, RigFile, TurntablePart
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan_turntable import BoardFaultError, ScanTurntable
from rhizotwin.rig.table.hat import HatLights, HatTurntable
from rhizotwin.rig.table.ramp import step_times_s
from rhizotwin.rig.twin.clock import VirtualClock
from rhizotwin.scenes.model import Scene

HAT = HatPart()
RIG = RigFile(turntable=TurntablePart(kind="hat", full_step_deg=0.18), hat=HAT)


@dataclass
class _Driver:
    """A DRV8825 behind lgpio, whose functions are its methods: it steps on rising edges while it is enabled."""

    clock: VirtualClock
    level: dict[int, int] = field(default_factory=dict)
    motor: int = 0
    fault_after: int = 10**9
    ends_s: float = 0.0
    taken: frozenset[int] = frozenset()
    released: dict[int, int] = field(default_factory=dict)

    error = RuntimeError
    SET_PULL_UP, TX_WAVE = 32, 1

    def gpiochip_open(self, number: int) -> int:
        return number

    def gpiochip_close(self, _: int) -> None:
        if self.released:
            raise RuntimeError("unknown handle")
        self.released = dict(self.level)
        self.level.clear()

    def gpio_claim_output(self, _: int, pin: int, level: int) -> None:
        if pin in self.taken:
            raise RuntimeError("GPIO busy")
        self.level[pin] = level

    def gpio_write(self, _: int, pin: int, level: int) -> None:
        self.level[pin] = level

    def gpio_claim_input(self, _: int, pin: int, flags: int) -> None:
        assert flags == self.SET_PULL_UP
        self.level[pin] = 1

    def gpio_read(self, _: int, pin: int) -> int:
        return int(self.level[pin])

    def pulse(self, bits: int, mask: int, us: int) -> SimpleNamespace:
        return SimpleNamespace(bits=bits, mask=mask, us=us)

    def tx_wave(self, _: int, pin: int, wave: list[Any]) -> None:
        rising = sum(pulse.bits for pulse in wave)
        assert min(pulse.us for pulse in wave) >= 2  # the data sheet's least pulse
        if self.level[HAT.enable_pin] == 0:
            self.motor += rising * (1 if self.level[HAT.direction_pin] else -1)
        if rising >= self.fault_after:
            self.level[HAT.fault_pin] = 0
        self.ends_s = self.clock.now_s() + sum(pulse.us for pulse in wave) * 1e-6
        assert pin == HAT.step_pin

    def tx_busy(self, _: int, pin: int, kind: int) -> int:
        assert (pin, kind) == (HAT.step_pin, self.TX_WAVE)
        return int(self.clock.now_s() < self.ends_s)


@dataclass
class _Strip:
    """A strip of rpi_ws281x."""

    count: int
    pin: int
    hz: int
    dma: int
    channel: int
    brightness: int = 128
    next: dict[int, Any] = field(default_factory=dict)
    shown: dict[int, Any] = field(default_factory=dict)

    def begin(self) -> None:
        pass

    def numPixels(self) -> int:  # noqa: N802 - the library's name
        return self.count

    def setPixelColor(self, pixel: int, colour: Any) -> None:  # noqa: N802 - the library's name
        self.next[pixel] = colour

    def show(self) -> None:
        self.shown = dict(self.next)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> tuple[HatTurntable, HatLights, _Driver, list[_Strip]]:
    """Return table and lamps, the table at 0 degrees, with what they drive."""
    driver, strips = _Driver(VirtualClock()), list[_Strip]()

    def strip(*given: Any, **named: Any) -> _Strip:
        strips.append(_Strip(*given, **named))
        return strips[-1]

    monkeypatch.setitem(sys.modules, "lgpio", driver)
    monkeypatch.setitem(sys.modules, "rpi_ws281x", SimpleNamespace(PixelStrip=strip, Color=lambda *rgb: rgb))
    table, lights = open_board(RIG, clock=driver.clock)
    assert isinstance(table, HatTurntable)
    assert isinstance(lights, HatLights)
    table.prepare()
    assert not table.knows_zero()
    table.declare(0.0)
    return table, lights, driver, strips


def test_the_motor_stands_as_read_and_arrives_from_below(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    table, _, driver, _ = bench
    last: list[int] = []
    wave = driver.tx_wave
    monkeypatch.setattr(driver, "tx_wave", lambda *given: (wave(*given), last.append(driver.level[HAT.direction_pin])))
    start = driver.motor
    for angle_deg in (9.0, 18.0, 4.5, -9.0, 351.0, 340.0):
        assert table.move_to(angle_deg) == pytest.approx(angle_deg, abs=0.18 / 32 / 2)
        assert (driver.motor - start) * 0.18 / 32 == pytest.approx(table.position_deg())
        assert last[-1] == 1
    assert table.knows_zero()
    with pytest.raises(UnsafeError, match="at least -90 deg"):
        table.move_to(-91.0)


def test_a_scan_accepts_angles_between_the_microsteps(bench: Any) -> None:
    rig = replace(RIG, turntable=replace(RIG.turntable, full_step_deg=1.8))
    table, _ = open_board(rig, clock=bench[2].clock)
    table.prepare()
    table.declare(0.0)
    devices: Any = SimpleNamespace(rig=rig, table=table)
    unused: Any = None
    turntable = ScanTurntable(devices, Scene(), unused, Observers(), note=lambda *_: None)
    for angle_deg in np.arange(7) * 360.0 / 7.0:
        turntable.turn(angle_deg)
        turntable.verify(angle_deg)
    with pytest.raises(BoardFaultError, match="instead of"):
        turntable.verify(300.0)


def test_a_fault_loses_the_angle(bench: Any) -> None:
    table, _, driver, _ = bench
    driver.fault_after = 1000
    with pytest.raises(LostError, match="DRV8825 reports a fault"):
        table.move_to(90.0)
    assert not table.knows_zero()
    assert driver.level[HAT.enable_pin] == 1


def test_a_move_that_is_stopped_loses_the_angle(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    table, _, driver, _ = bench
    monkeypatch.setattr(driver, "tx_busy", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        table.move_to(90.0)
    assert not table.knows_zero()
    assert driver.level[HAT.enable_pin] == 1  # the pulses under way turn nothing


def test_a_closed_table_is_off_and_can_be_closed_again(bench: Any) -> None:
    table, _, driver, _ = bench
    for _ in range(2):
        table.close()
    assert driver.released[HAT.enable_pin] == 1


def test_lamps_and_a_band_with_its_own_pin(bench: Any) -> None:
    _, lights, driver, strips = bench
    lights.set(panel=0.5, front=1.0)
    panel, front = strips
    assert (panel.pin, panel.channel, front.pin, front.channel) == (18, 0, 13, 1)
    assert panel.brightness == front.brightness == 255
    assert panel.shown == dict.fromkeys(range(300), (128, 128, 128))
    assert front.shown == dict.fromkeys(range(18), (255, 255, 255))
    rig = replace(RIG, camera=replace(RIG.camera, bands=(BandPart(name="nir", panel_rgb=(255, 0, 0), output=5),)))
    lights = open_board(rig, clock=driver.clock)[1]
    lights.set(panel=1.0, front=0.0, band=rig.camera.bands[0])
    assert strips[-2].shown == dict.fromkeys(range(300), (255, 0, 0))
    assert driver.level[5] == 1
    lights.off()
    assert set(strips[-2].shown.values()) | set(strips[-1].shown.values()) == {(0, 0, 0)}
    assert driver.level[5] == 0


def test_the_shutter_contact_is_closed_for_a_while(bench: Any) -> None:
    driver = bench[2]
    lights, began_s = open_board(RIG, clock=driver.clock)[1], driver.clock.now_s()
    lights.release_shutter(6)
    assert driver.level[6] == 0
    assert driver.clock.now_s() - began_s == pytest.approx(0.1)
    with pytest.raises(ValueError, match="pin=None"):
        lights.release_shutter(None)
    driver.clock.sleep = Mock(side_effect=KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        lights.release_shutter(6)
    assert driver.level[6] == 0


def test_a_pin_in_use_and_a_missing_library_are_named(monkeypatch: pytest.MonkeyPatch, bench: Any) -> None:
    driver = bench[2]
    driver.taken = frozenset({HAT.step_pin})
    with pytest.raises(RigError, match="gpio_claim_output of GPIO 23 failed"):
        open_board(RIG, clock=driver.clock)[0].prepare()
    monkeypatch.setitem(sys.modules, "lgpio", None)
    with pytest.raises(RigError, match="the library lgpio is missing"):
        open_board(RIG, clock=VirtualClock())


@pytest.mark.parametrize("steps", [7, 300])
def test_ramp_is_that_of_a_body_that_is_pushed_evenly(steps: int) -> None:
    speed, acceleration = 300.0, 900.0
    due_s = step_times_s(steps, speed=speed, acceleration=acceleration)
    dt = 1e-5
    at, v, t, found = 0.0, 0.0, 0.0, []
    while len(found) < steps and t < 60.0:  # brute force: push, go on, brake when the rest is the braking way
        braking = v * v / (2.0 * acceleration) >= steps - at
        v = max(v - acceleration * dt, 1e-3) if braking else min(v + acceleration * dt, speed)
        at, t = at + v * dt, t + dt
        if at >= len(found) + 1:
            found.append(t)
    assert np.all(np.diff(due_s) > 0.0)
    assert due_s[: len(found)] == pytest.approx(found, abs=0.02)
    assert len(found) >= steps - 1
