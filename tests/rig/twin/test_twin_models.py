"""Servo, stepper, lamp and clock of the twin: physics in virtual time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.table.ramp import move_s
from rhizotwin.rig.twin.clock import VirtualClock
from rhizotwin.rig.twin.imperfections import BENCH, CLEAN, Imperfections
from rhizotwin.rig.twin.lamps import Lamp
from rhizotwin.rig.twin.servo import DEG_PER_COUNT, Servo
from rhizotwin.rig.twin.stepper import MICROSTEPS, Stepper
from rhizotwin.rig.twin.swing import Swing


def servo(wrong: Imperfections = CLEAN, *, start: float = 500.0, key: tuple[int, ...] = (0, 1)) -> Servo:
    return Servo(start_counts=start, imperfections=wrong, key=key)


def arrived(unit: Servo, counts: int, duration_ms: int = 1000) -> Servo:
    unit.move(counts, duration_ms)
    unit.advance(10.0)
    return unit


def test_a_servo_moves_at_uniform_speed_within_its_time_and_reads_whole_counts() -> None:
    unit, bench = servo(), servo(BENCH)
    unit.move(501, 1000)
    unit.advance(0.3)
    assert unit.counts == 500
    assert unit.true_counts == pytest.approx(500.3)
    unit.advance(0.7)
    assert not unit.moving
    unit.move(1000, 0)  # too short for it: 60 degrees, 250 counts, take 0.22 s
    unit.advance(0.22)
    assert unit.true_counts == pytest.approx(751.0)
    unit.advance(0.22)
    assert unit.true_counts == pytest.approx(1000.0)
    assert pytest.approx(0.24) == DEG_PER_COUNT
    coarse = servo(BENCH)
    for one, steps in ((bench, 100), (coarse, 1)):  # steps of time do not matter
        one.move(700, 1000)
        for _ in range(steps):
            one.advance(0.7 / steps)
    assert bench.true_counts == pytest.approx(coarse.true_counts, abs=1e-9)


def test_play_has_the_sign_of_the_approach_and_an_error_belongs_to_the_move_not_to_the_place() -> None:
    below, above = (arrived(servo(Imperfections(servo_backlash_deg=(0.8, 0.8)), start=start), 500) for start in (400.0, 600.0))
    assert below.counts == above.counts == 500
    assert (above.true_counts - below.true_counts) * DEG_PER_COUNT == pytest.approx(0.8)
    unit, other = (servo(Imperfections(servo_repeat_deg=0.3)) for _ in range(2))
    assert arrived(unit, 600).true_counts == arrived(other, 600).true_counts
    spread = [(arrived(unit, 500 + 100 * (k % 2)).true_counts - 500.0 - 100.0 * (k % 2)) * DEG_PER_COUNT for k in range(400)]
    assert np.std(spread) == pytest.approx(0.3, rel=0.15)


def test_zero_and_scale_errors_stay_within_their_bounds() -> None:
    zeros, scales = [], []
    for seed in range(200):
        unit = servo(Imperfections(servo_zero_deg=2.0, servo_scale=0.01), key=(seed, 5))
        zeros.append((unit.true_counts - 500.0) * DEG_PER_COUNT)
        scales.append((arrived(unit, 1000).true_counts - 500.0 - zeros[-1] / DEG_PER_COUNT) / 500.0 - 1.0)
    assert max(map(abs, zeros)) <= 2.0
    assert np.std(zeros) == pytest.approx(2.0 / math.sqrt(3.0), rel=0.2)
    assert 0.008 < max(map(abs, scales)) <= 0.01 + 1e-12


def test_sag_is_linear_in_the_torque_and_half_seen_and_a_dead_band_moves_nothing() -> None:
    unit = servo(Imperfections(servo_sag_deg=(1.2, 1.2)))
    unit.load(True)
    for torque, sag_deg, seen in ((0.0, 0.0, 0), (0.5, 0.6, 1), (1.0, 1.2, 2), (-1.0, -1.2, -2)):
        unit.torque = torque
        assert (unit.true_counts - 500.0) * DEG_PER_COUNT == pytest.approx(sag_deg)
        assert unit.counts - 500 == seen
    unit = servo(Imperfections(servo_dead_band_counts=2))
    assert arrived(unit, 502, 100).counts == 500
    assert unit.command == (502, 100)
    assert arrived(unit, 503).counts in (502, 503, 504)


def test_without_torque_gravity_wins_over_friction() -> None:
    light, heavy = servo(), servo()
    light.torque, heavy.torque = 0.2, 1.0
    for unit in (light, heavy):
        unit.advance(0.5)
    assert light.counts == 500
    assert heavy.counts > 550
    heavy.load(True)
    held = heavy.counts
    heavy.advance(5.0)
    assert heavy.counts == held
    unit = arrived(servo(), 600)
    unit.load(False)
    unit.torque = 1.0
    unit.advance(0.2)
    assert unit.counts > 620
    unit.torque = 0.0
    unit.load(True)  # goes to the last command
    unit.advance(2.0)
    assert unit.counts == 600


def test_a_hot_servo_lets_go_until_it_is_cool_and_a_stalled_one_gets_hot() -> None:
    unit = arrived(servo(), 520)
    unit.heat(90.0)
    assert unit.celsius == 90
    assert unit.torque_on
    for seconds, holds in ((0.0, False), (20.0, False), (300.0, True)):
        unit.advance(seconds)
        assert unit.holds == holds
    unit = servo()
    unit.stalled = True
    unit.move(900, 1000)
    unit.advance(30.0)
    assert unit.celsius > 32
    held = []
    for _ in range(60):
        unit.advance(10.0)
        held.append(unit.holds)
    assert not all(held)
    assert unit.counts == 500


def stepper(wrong: Imperfections = CLEAN, *, key: tuple[int, ...] = (0, 2)) -> Stepper:
    return Stepper(full_step_deg=1.8, imperfections=wrong, key=key)


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
    table.acceleration_deg_per_s2 = 15.0
    table.queue(99.0, 30.0)
    assert table.remaining_s() == pytest.approx(2.0 * np.sqrt(9.0 / 15.0), rel=1e-3)
    assert table.remaining_s() == pytest.approx(move_s(9.0, speed=30.0, acceleration=15.0), rel=1e-3)


def test_the_error_within_steps_depends_on_the_position_only() -> None:
    table = stepper(Imperfections(table_microstep_deg=0.075))
    table.energise()
    errors = [turned(table, k * 0.45) - k * 0.45 for k in range(33)]
    assert 0.03 < max(errors) - min(errors) <= 0.15 + 1e-9
    assert turned(table, 4.5) - 4.5 == pytest.approx(errors[10], abs=1e-12)
    assert [errors[0], errors[3]] == pytest.approx([errors[16], errors[19]], abs=1e-12)  # 4 full steps are one electrical turn


def test_the_rotor_jumps_when_first_energised_only() -> None:
    jumps = []
    for seed in range(50):
        table = stepper(Imperfections(table_jump_steps=2.0), key=(seed, 3))
        before = table.true_deg
        table.energise()
        jumps.append(table.true_deg - before)
        table.release()
        table.energise()
        assert table.true_deg - before == pytest.approx(jumps[-1])
    assert 2.0 < max(map(abs, jumps)) <= 3.6


def test_a_rotor_stands_on_whole_microsteps_and_released_on_full_steps() -> None:
    table = stepper()
    assert turned(table, 5.02) == pytest.approx(round(5.02 * MICROSTEPS / 1.8) * 1.8 / MICROSTEPS)
    table.release()
    assert table.true_deg == pytest.approx(5.4)
    table.energise()
    assert table.true_deg == pytest.approx(5.0, abs=0.03)


def test_play_is_taken_up_by_arriving_from_one_side_and_power_up_keeps_the_place() -> None:
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
    still = Swing(hz=0.0, damping=1.0)
    still.turn(1.0, 0.0, 60.0)
    assert still.twist_deg == 0.0


@given(st.lists(st.floats(-400.0, 400.0), min_size=1, max_size=6), st.floats(1.0, 90.0))
def test_queued_moves_end_where_the_last_one_says(goals: list[float], speed: float) -> None:
    table = stepper()
    for goal in goals:
        table.queue(goal, speed)
    whole_s = table.remaining_s()
    table.advance(whole_s / 3.0)
    assert table.remaining_s() == pytest.approx(whole_s * 2.0 / 3.0, abs=1e-9)
    table.advance(whole_s)
    assert not table.moving
    assert table.steps == round(goals[-1] * table.steps_per_deg)


def test_a_lamp_follows_with_a_ramp() -> None:
    lamp = Lamp(full_rgb=(255, 255, 255), imperfections=Imperfections(lamp_ramp_s=0.2), key=(0,))
    lamp.show((255, 255, 255))
    for dim, seconds, level in ((None, 0.1, 0.5), (None, 1.0, 1.0), (51, 1.0, 0.2)):
        if dim is not None:
            lamp.dim(dim)
        lamp.advance(seconds)
        assert lamp.level == pytest.approx(level)
    lamp = Lamp(full_rgb=(255, 255, 255), imperfections=CLEAN, key=(0,))
    lamp.show((255, 0, 255), led=3)  # one of thirty
    assert lamp.level == pytest.approx(2.0 / 3.0 / 30.0)


class _Beats:
    """A source with something to do every second."""

    def __init__(self) -> None:
        self.at: list[float] = []

    def next_s(self) -> float:
        return float(len(self.at) + 1)

    def advance_to(self, now_s: float) -> None:
        if now_s >= self.next_s():
            self.at.append(now_s)


def test_virtual_time_stops_at_every_event_and_never_sleeps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _s: pytest.fail("slept"))
    clock, beats = VirtualClock(), _Beats()
    clock.add(beats)
    for action, argument, now_s in (
        (clock.sleep, 3.5, 3.5),
        (clock.sleep, -1.0, 3.5),
        (clock.advance_to, 1.0, 3.5),
        (clock.step, 100.0, 4.0),
    ):
        action(argument)
        assert clock.now_s() == now_s
    assert beats.at == [1.0, 2.0, 3.0, 4.0]
