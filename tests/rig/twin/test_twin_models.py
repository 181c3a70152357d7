"""Servo and stepper of the twin, and what hangs from its lid: physics in virtual time."""

import numpy as np
import pytest

from rhizotwin.rig.twin.imperfections import CLEAN, Imperfections
from rhizotwin.rig.twin.servo import DEG_PER_COUNT, Servo
from rhizotwin.rig.twin.stepper import MICROSTEPS, Stepper
from rhizotwin.rig.twin.swing import Swing


def servo(wrong: Imperfections = CLEAN, *, start: float = 500.0) -> Servo:
    return Servo(start_counts=start, imperfections=wrong, key=(0, 1))


def arrived(unit: Servo, counts: int, duration_ms: int = 1000) -> Servo:
    unit.move(counts, duration_ms)
    unit.advance(10.0)
    return unit


def test_a_servo_moves_uniformly_and_reads_whole_counts() -> None:
    unit = servo()
    unit.move(501, 1000)
    unit.advance(0.3)
    assert (unit.counts, unit.true_counts) == (500, pytest.approx(500.3))
    unit.advance(0.7)
    unit.move(1000, 0)  # too short for it: 60 degrees, 250 counts, take 0.22 s
    unit.advance(0.22)
    assert unit.true_counts == pytest.approx(751.0)


def test_play_is_of_the_approach_and_an_error_of_the_move() -> None:
    below, above = (arrived(servo(Imperfections(servo_backlash_deg=(0.8, 0.8)), start=start), 500) for start in (400.0, 600.0))
    assert below.counts == above.counts == 500
    assert (above.true_counts - below.true_counts) * DEG_PER_COUNT == pytest.approx(0.8)
    unit, other = (servo(Imperfections(servo_repeat_deg=0.3)) for _ in range(2))
    assert arrived(unit, 600).true_counts == arrived(other, 600).true_counts
    spread = [(arrived(unit, 500 + 100 * (k % 2)).true_counts - 500.0 - 100.0 * (k % 2)) * DEG_PER_COUNT for k in range(400)]
    assert np.std(spread) == pytest.approx(0.3, rel=0.15)


def test_sag_is_linear_and_half_seen_a_dead_band_moves_nothing() -> None:
    unit = servo(Imperfections(servo_sag_deg=(1.2, 1.2)))
    unit.load(True)
    for torque, sag_deg, seen in ((0.0, 0.0, 0), (0.5, 0.6, 1), (1.0, 1.2, 2), (-1.0, -1.2, -2)):
        unit.torque = torque
        assert (unit.true_counts - 500.0) * DEG_PER_COUNT == pytest.approx(sag_deg)
        assert unit.counts - 500 == seen
    unit = servo(Imperfections(servo_dead_band_counts=2))
    assert arrived(unit, 502, 100).counts == 500
    assert arrived(unit, 503).counts in (502, 503, 504)


def stepper(wrong: Imperfections = CLEAN) -> Stepper:
    return Stepper(full_step_deg=1.8, imperfections=wrong, key=(0, 2))


def turned(table: Stepper, goal_deg: float) -> float:
    table.queue(goal_deg, 30.0)
    table.advance(table.remaining_s() + 1e-9)
    assert not table.moving
    return table.true_deg


def test_a_table_takes_the_time_of_a_trapezoid() -> None:
    table = stepper()
    table.queue(90.0, 30.0)
    assert table.remaining_s() == pytest.approx(90.0 / 30.0 + 30.0 / 60.0, rel=1e-3)
    table.advance(1.0)
    before = table.true_deg
    table.advance(0.5)
    assert table.true_deg - before == pytest.approx(15.0)
    table.advance(5.0)
    assert table.true_deg == pytest.approx(90.0)
    assert table.steps == 1600


def test_a_rotor_on_microsteps_full_steps_and_its_first_jump() -> None:
    table = stepper()
    assert turned(table, 5.02) == pytest.approx(round(5.02 * MICROSTEPS / 1.8) * 1.8 / MICROSTEPS)
    table.release()
    assert table.true_deg == pytest.approx(5.4)
    table.energise()
    assert table.true_deg == pytest.approx(5.0, abs=0.03)
    table = stepper(Imperfections(table_jump_steps=2.0))
    before = table.true_deg
    table.energise()
    jumped = table.true_deg - before
    assert 0.0 < abs(jumped) <= 3.6
    table.release()
    table.energise()
    assert table.true_deg - before == pytest.approx(jumped)


def test_play_is_taken_up_from_one_side_power_up_keeps_place() -> None:
    table = stepper(Imperfections(table_play_deg=0.2))
    up = turned(table, 36.0)
    turned(table, 50.4)
    assert turned(table, 36.0) - up == pytest.approx(0.2)
    turned(table, 32.4)
    assert turned(table, 36.0) == pytest.approx(up)
    table.power_up()
    assert (table.steps, table.energised) == (0, False)
    assert table.true_deg == pytest.approx(up)


def test_the_motion_in_pieces_is_the_motion() -> None:
    """Speed and acceleration of the pieces add up to where the table goes, however the time is cut."""
    table = stepper()
    table.queue(40.0, 30.0)
    table.queue(35.0, 30.0)
    at, rng = 0.0, np.random.default_rng(0)
    while table.moving:
        dt_s = float(rng.uniform(0.001, 0.3))
        pieces = list(table.motion(dt_s))
        assert sum(seconds for seconds, _, _ in pieces) == pytest.approx(dt_s)
        at += sum(seconds * speed + gain * seconds**2 / 2.0 for seconds, speed, gain in pieces)
        table.advance(dt_s)
        assert at == pytest.approx(table.true_deg, abs=1e-6)
    assert at == pytest.approx(35.0, abs=0.03)


@pytest.mark.parametrize("damping", [0.1, 1.4])
def test_what_hangs_twists_as_its_equation_says(damping: float) -> None:
    """Against small steps of time, with the pot sped up, turned and stopped at once."""
    swing, w = Swing(hz=0.86, damping=damping), 2.0 * np.pi * 0.86
    twist = rate = seen = 0.0
    dt_s = 5e-5
    for seconds, speed, gain in ((0.4, 0.0, 60.0), (0.3, 24.0, 0.0), (1.0, 0.0, 0.0)):
        rate += seen - speed  # the jolt
        for k in range(round(seconds / dt_s)):
            now = speed + gain * k * dt_s
            rate += dt_s * (-gain - 2.0 * damping * w * (rate + now) - w**2 * twist)
            twist += dt_s * rate
        seen = speed + gain * seconds
        for _ in range(4):
            swing.turn(seconds / 4.0, speed, gain)
            speed += gain * seconds / 4.0
        assert swing.twist_deg == pytest.approx(twist, abs=1e-2)
    swing.turn(60.0, 0.0, 0.0)
    assert swing.twist_deg == 0.0
