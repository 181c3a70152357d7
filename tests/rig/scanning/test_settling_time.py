"""The rest that pictures need after a stop."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.rig.devices import Shot
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.scanning.settling_time import SettlingTime, measure_settling_time
from rhizotwin.rig.table.ramp import move_s
from rhizotwin.scenes.model import CapturePlan, Ring
from tests.rig.fake_devices import SCENE, World, devices


def swinging(at_s: float, *, amplitude_px: float, decay_s: float, noise: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return a picture of upright stripes that swing at 2 Hz and come to rest."""
    shift = amplitude_px * np.exp(-at_s / decay_s) * np.cos(2.0 * np.pi * 2.03 * at_s)
    x = np.arange(160.0) - shift
    stripes = 20000.0 + 8000.0 * np.tanh(2.0 * np.sin(x / 4.0))
    return np.clip(np.tile(stripes, (120, 1)) + rng.normal(0.0, noise, (120, 160)), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize("decay_s", [0.3, 1.5])
def test_the_rest_is_where_the_swing_drowns_in_noise(decay_s: float) -> None:
    rng, times = np.random.default_rng(0), np.arange(0.0, 12.0, 0.25)
    noise, amplitude = 200.0, 3.0

    def measured(decay_s: float, times: NDArray[np.float64]) -> SettlingTime:
        pictures = [swinging(t, amplitude_px=amplitude, decay_s=decay_s, noise=noise, rng=rng) for t in times]
        return measure_settling_time(pictures, times.tolist())

    found = measured(decay_s, times)
    slope = 8000.0 * 0.25 * np.sqrt(np.mean((2.0 / np.cosh(2.0 * np.sin(np.arange(160) / 4.0)) ** 2 * np.cos(np.arange(160) / 4.0)) ** 2))
    # moved beyond 1.15 times the noise: the swing makes sqrt(1.15^2 - 1) of it
    expected = decay_s * np.log(amplitude * slope / (noise * np.sqrt(1.15**2 - 1.0)))
    assert found.rest_s is not None
    assert expected - 0.6 <= found.rest_s <= expected + 0.6  # half a period of its swing and a look either way
    assert found.moved > 5.0
    assert measured(30.0, times[:24]).rest_s is None


CASES = {
    "gentleness helps": (lambda acceleration: 1.2 if acceleration > 20.0 else 0.01, 15.0, 0.5, 0.5),
    "never at rest": (lambda _: 60.0, 7.5, 12.0, 12.0),
}
"""How long the picture swings after a turn at an acceleration; the acceleration to be chosen and the bounds of the rest."""


@pytest.mark.parametrize(("decay_s", "chosen_deg_per_s2", "least_s", "most_s"), CASES.values(), ids=CASES)
def test_a_scan_turns_and_rests_as_it_saw_the_water_move(
    decay_s: Callable[[float], float], chosen_deg_per_s2: float, least_s: float, most_s: float, tmp_path: Path
) -> None:
    world = World(scene=replace(SCENE, plan=CapturePlan(rings=(Ring(views=6),))))
    opened = devices(world)
    opened.rig = replace(opened.rig, turntable=replace(opened.rig.turntable, rest="measured"))
    rng, rests, stopped = np.random.default_rng(3), list[float](), [0.0]
    move, capture = opened.table.move_to, opened.camera.capture

    def moving(angle_deg: float) -> float:
        way = abs(angle_deg - (world.counter_deg or 0.0))
        read = move(angle_deg)
        world.clock.at_s += move_s(way, speed=30.0, acceleration=world.acceleration_deg_per_s2)
        stopped[0] = world.clock.at_s
        return read

    def sloshing() -> Shot:
        since_s = world.clock.at_s - stopped[0]
        rests.append(since_s)
        shot = capture()
        swing = 6.0 * np.exp(-since_s / decay_s(world.acceleration_deg_per_s2)) * np.cos(2.0 * np.pi * 2.03 * since_s)
        moved = np.roll(shot.image, round(swing), axis=1).astype(np.float64)
        full = np.iinfo(shot.image.dtype).max
        return replace(shot, image=np.clip(moved + rng.normal(0.0, 0.005 * full, moved.shape), 0, full).astype(shot.image.dtype))

    opened.table.move_to, opened.camera.capture = moving, sloshing
    said: list[str] = []
    dataset = scan(opened, world.scene, tmp_path / "scan", observers=Observers(say=said.append))
    assert world.acceleration_deg_per_s2 == chosen_deg_per_s2
    assert sum("pause before each picture is" in text for text in said) == 1
    rest_s = min(rests[-len(dataset.frames) :])
    assert least_s - 1e-6 <= rest_s <= most_s + 1e-6
