"""The bus-servo protocol against frames written out by hand from the manual."""

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rhizotwin.rig.arm.lx_bus import LxBus, find_reply
from rhizotwin.rig.arm.servo_bus import check_move
from rhizotwin.rig.errors import NoAnswerError, UnsafeError
from tests.rig.arm.fake_bus import SILENT, ScriptedLine, scripted

ASK_POS_1, POS_1_IS_500 = "55 55 01 03 1c df", "55 55 01 05 1c f4 01 e8"
POS_1_IS_MINUS_3 = "55 55 01 05 1c fd ff e1"
ASK_POS_2, POS_2_IS_500 = "55 55 02 03 1c de", "55 55 02 05 1c f4 01 e7"
ASK_LOAD_1, LOAD_1_ON, LOAD_1_OFF = "55 55 01 03 20 db", "55 55 01 04 20 01 d9", "55 55 01 04 20 00 da"
ASK_LOAD_2, LOAD_2_OFF = "55 55 02 03 20 da", "55 55 02 04 20 00 d9"
# Servo 1 to 500, servo 2 to 600, in 1000 ms.
WAIT_1, ASK_WAIT_1, WAIT_1_IS = "55 55 01 07 07 f4 01 e8 03 10", "55 55 01 03 08 f3", "55 55 01 07 08 f4 01 e8 03 0f"
WAIT_2, ASK_WAIT_2, WAIT_2_IS = "55 55 02 07 07 58 02 e8 03 aa", "55 55 02 03 08 f2", "55 55 02 07 08 58 02 e8 03 a9"
START_ALL, START_2 = "55 55 fe 03 0b f3", "55 55 02 03 0b ef"
ASK_MOVE_1, MOVE_1_IS, MOVE_1_IS_NOT = "55 55 01 03 02 f9", "55 55 01 07 02 f4 01 e8 03 15", "55 55 01 07 02 00 00 00 00 f5"
ASK_MOVE_2, MOVE_2_IS, MOVE_2_IS_NOT = "55 55 02 03 02 f8", "55 55 02 07 02 58 02 e8 03 af", "55 55 02 07 02 00 00 00 00 f4"
ARMED = [(WAIT_1, SILENT), (ASK_WAIT_1, WAIT_1_IS), (WAIT_2, SILENT), (ASK_WAIT_2, WAIT_2_IS)]
STARTED = [(START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS), (ASK_MOVE_2, MOVE_2_IS)]
TO_500_AND_600 = {1: 500, 2: 600}


USELESS = {
    "silence": SILENT,
    "echo only": ASK_POS_1,
    "damaged": "55 55 01 05 1c f4 02 e8",
    "cut": "55 55 01 05 1c f4 01",
    "another servo": POS_2_IS_500,
    "another length": "55 55 01 04 1c f4 ea",
}


@pytest.mark.parametrize("heard", USELESS.values(), ids=USELESS)
def test_asks_again_and_then_gives_up(heard: str) -> None:
    with scripted(LxBus, (ASK_POS_1, heard), (ASK_POS_1, POS_1_IS_500)) as bus:
        assert bus.positions([1]) == {1: 500}
    line = ScriptedLine(*[(ASK_POS_1, heard)] * 5)
    with pytest.raises(NoAnswerError, match="servo 1 does not reply"):
        LxBus(line).positions([1])
    assert not line.script
    assert line.clock.at_s < 1.1


def test_readings() -> None:
    with scripted(LxBus, (ASK_POS_1, POS_1_IS_500 * 2), (ASK_POS_1, POS_1_IS_MINUS_3), piece=8) as bus:
        assert [bus.positions([1]) for _ in range(2)] == [{1: 500}, {1: -3}]  # what arrived before the question is no answer
    for piece in (1, 1000):
        with scripted(LxBus, (ASK_POS_2, POS_2_IS_500), (ASK_POS_1, POS_1_IS_MINUS_3), piece=piece) as bus:
            assert bus.positions([2, 1]) == {2: 500, 1: -3}
    with scripted(LxBus, ("55 55 01 03 1b e0", "55 55 01 05 1b e8 1c da"), ("55 55 02 03 1b df", "55 55 02 05 1b 1c 1b a6")) as bus:
        assert bus.voltage_v([1, 2]) == pytest.approx(6.94)  # the lowest
    with scripted(LxBus, ("55 55 01 03 1a e1", "55 55 01 04 1a 1f c1"), ("55 55 02 03 1a e0", "55 55 02 04 1a 29 b6")) as bus:
        assert bus.temperatures_c([1, 2]) == {1: 31, 2: 41}
    with scripted(LxBus, (ASK_LOAD_1, LOAD_1_ON), (ASK_LOAD_2, LOAD_2_OFF)) as bus:
        assert bus.loaded([1, 2]) == {1: True, 2: False}


@pytest.mark.parametrize("echo", [True, False], ids=["echo", "no echo"])
def test_a_move_waits_everywhere_and_starts_at_once(echo: bool) -> None:
    with scripted(LxBus, *ARMED, *STARTED, echo=echo) as bus:
        bus.move(TO_500_AND_600, 1.0)


def test_a_target_not_taken_is_sent_again_before_a_move() -> None:
    with scripted(LxBus, (WAIT_1, SILENT), (ASK_WAIT_1, "55 55 01 07 08 f3 01 e8 03 10"), *ARMED, *STARTED) as bus:
        bus.move(TO_500_AND_600, 1.0)
    with (
        scripted(LxBus, *ARMED[:2], *[(WAIT_2, SILENT), (ASK_WAIT_2, "55 55 02 07 08 00 00 00 00 ee")] * 4) as bus,
        pytest.raises(NoAnswerError, match="servo 2 replies but does not accept commands"),
    ):
        bus.move(TO_500_AND_600, 1.0)


def test_a_servo_that_missed_the_start_is_started_by_number() -> None:
    missed = [(START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS), (ASK_MOVE_2, MOVE_2_IS_NOT)]
    with scripted(LxBus, *ARMED, *missed, (START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS)) as bus:
        bus.move(TO_500_AND_600, 1.0)
    with (
        scripted(LxBus, *ARMED, *missed, *[(START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS_NOT)] * 3) as bus,
        pytest.raises(NoAnswerError, match="servo 2 did not start"),
    ):
        bus.move(TO_500_AND_600, 1.0)


def test_a_single_servo_is_started_by_number() -> None:
    with scripted(LxBus, *ARMED[2:], (START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS)) as bus:
        bus.move({2: 600}, 1.0)


def test_servos_that_never_report_a_start_are_left_alone() -> None:
    not_started = [(ASK_MOVE_1, MOVE_1_IS_NOT), (ASK_MOVE_2, MOVE_2_IS_NOT)]
    one_by_one = [("55 55 01 03 0b f0", SILENT), (START_2, SILENT), *not_started]
    with scripted(LxBus, *ARMED, (START_ALL, SILENT), *not_started, *one_by_one * 3) as bus:
        bus.move(TO_500_AND_600, 1.0)


def test_nothing_is_sent_that_must_not_be() -> None:
    for targets, duration_s, says in (
        ({1: 500, 2: 1001}, 1.0, "position 1001 of servo 2"),
        ({1: -1}, 1.0, "position -1 of servo 1"),
        ({1: 500}, 30.001, "outside 0 to 30 s"),
        ({1: 500}, float("nan"), "outside 0 to 30 s"),
        ({254: 500}, 1.0, "servo number 254"),
    ):
        with pytest.raises(UnsafeError, match=says):
            LxBus(ScriptedLine()).move(targets, duration_s)
    check_move({0: 0, 253: 1000}, 30.0)


def test_torque_is_switched_until_it_reads_so_of_each_servo() -> None:
    on, off = "55 55 01 04 1f 01 da", "55 55 01 04 1f 00 db"
    with scripted(LxBus, (on, SILENT), (ASK_LOAD_1, LOAD_1_OFF), (on, SILENT), (ASK_LOAD_1, LOAD_1_ON)) as bus:
        bus.load([1], True)
    silent = [(off, SILENT), *[(ASK_LOAD_1, SILENT)] * 5]
    with (
        scripted(LxBus, *silent, ("55 55 02 04 1f 00 da", SILENT), (ASK_LOAD_2, LOAD_2_OFF)) as bus,
        pytest.raises(NoAnswerError, match="servo 1"),
    ):
        bus.load([1, 2], False)


def test_stop_asks_nothing() -> None:
    with scripted(LxBus, *[("55 55 01 03 0c ef", SILENT), ("55 55 02 03 0c ee", SILENT)] * 2) as bus:
        bus.stop([1, 2])


def test_silence_of_the_adapter_or_of_a_servo() -> None:
    silence = [(ASK_POS_1, SILENT)] * 5
    with pytest.raises(NoAnswerError, match="the adapter sends no echo"):
        LxBus(ScriptedLine(*silence), echo="yes").positions([1])
    for bus in (LxBus(ScriptedLine(*silence, echo=True), echo="yes"), LxBus(ScriptedLine(*silence), echo="no")):
        with pytest.raises(NoAnswerError, match="check the servos' supply"):
            bus.positions([1])


def by_hand(counts: int) -> bytes:
    """Return the answer of servo 1 about its position."""
    low, high = counts & 0xFF, counts >> 8 & 0xFF
    return bytes([0x55, 0x55, 0x01, 0x05, 0x1C, low, high, 255 - (0x01 + 0x05 + 0x1C + low + high) % 256])


POSITIONS = st.integers(-32768, 32767)
ECHO = bytes.fromhex(ASK_POS_1)
RUBBISH = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([bytes.fromhex(other) for other in [*USELESS.values(), "55 55 01 07 08 f4", "55 55 01 05 1b e8 1c da"]]),
    st.lists(st.sampled_from([0x55, 0x01, 0x05, 0x1C]), max_size=12).map(bytes),
    st.integers(0, 7).map(lambda size: bytes.fromhex(POS_1_IS_500)[:size]),
)


@given(before=st.lists(RUBBISH, max_size=4), counts=POSITIONS, times=st.integers(1, 3), behind=RUBBISH, cut=st.integers(0, 7))
def test_finds_the_answer_in_any_rubbish(before: list[bytes], counts: int, times: int, behind: bytes, cut: int) -> None:
    answer = by_hand(counts)
    assume(answer[:5] not in behind)
    assert find_reply(b"".join(before) + answer * times + behind + answer[:cut], 1, 28, 2) == answer[5:7]


@given(counts=POSITIONS, at=st.integers(0, 7), flip=st.integers(1, 255), echoes=st.integers(0, 2))
def test_never_believes_a_damaged_answer(counts: int, at: int, flip: int, echoes: int) -> None:
    damaged = bytearray(by_hand(counts))
    damaged[at] ^= flip
    assert find_reply(ECHO * echoes + bytes(damaged), 1, 28, 2) is None
