"""The bus-servo protocol against frames written out by hand from the manual."""

from collections.abc import Iterable
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.arm.lx_bus import LxBus, find_reply, frame
from rhizotwin.rig.arm.servo_bus import check_move
from rhizotwin.rig.errors import NoAnswerError, UnsafeError

SILENT = ""
ASK_POS_1, POS_1_IS_500 = "55 55 01 03 1c df", "55 55 01 05 1c f4 01 e8"
POS_1_IS_MINUS_3 = "55 55 01 05 1c fd ff e1"
ASK_POS_2, POS_2_IS_500 = "55 55 02 03 1c de", "55 55 02 05 1c f4 01 e7"
ASK_LOAD_1, LOAD_1_ON, LOAD_1_OFF = "55 55 01 03 20 db", "55 55 01 04 20 01 d9", "55 55 01 04 20 00 da"
ASK_LOAD_2, LOAD_2_ON, LOAD_2_OFF = "55 55 02 03 20 da", "55 55 02 04 20 01 d8", "55 55 02 04 20 00 d9"
# Servo 1 to 500, servo 2 to 600, in 1000 ms.
WAIT_1, ASK_WAIT_1, WAIT_1_IS = "55 55 01 07 07 f4 01 e8 03 10", "55 55 01 03 08 f3", "55 55 01 07 08 f4 01 e8 03 0f"
WAIT_2, ASK_WAIT_2, WAIT_2_IS = "55 55 02 07 07 58 02 e8 03 aa", "55 55 02 03 08 f2", "55 55 02 07 08 58 02 e8 03 a9"
START_ALL, START_2 = "55 55 fe 03 0b f3", "55 55 02 03 0b ef"
ASK_MOVE_1, MOVE_1_IS, MOVE_1_IS_NOT = "55 55 01 03 02 f9", "55 55 01 07 02 f4 01 e8 03 15", "55 55 01 07 02 00 00 00 00 f5"
ASK_MOVE_2, MOVE_2_IS, MOVE_2_IS_NOT = "55 55 02 03 02 f8", "55 55 02 07 02 58 02 e8 03 af", "55 55 02 07 02 00 00 00 00 f4"
ARMED = [(WAIT_1, SILENT), (ASK_WAIT_1, WAIT_1_IS), (WAIT_2, SILENT), (ASK_WAIT_2, WAIT_2_IS)]
STARTED = [(START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS), (ASK_MOVE_2, MOVE_2_IS)]


class _ScriptedLine:
    """A line that demands these writes in this order, and answers each with its bytes; time passes only in reads and sleeps."""

    def __init__(self, script: Iterable[tuple[str, str]], *, echo: bool = False, piece: int = 1000) -> None:
        self.script = [(bytes.fromhex(sent), bytes.fromhex(answer)) for sent, answer in script]
        self.clock = self
        self.closed = False
        self._echo = echo
        self._piece = piece
        self._input = b""
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        self._now_s += seconds

    def write(self, data: bytes) -> None:
        sent, answer = self.script.pop(0)
        assert data.hex(" ") == sent.hex(" ")
        self._input += (data if self._echo else b"") + answer

    def read(self, timeout_s: float) -> bytes:
        assert timeout_s > 0.0
        chunk, self._input = self._input[: self._piece], self._input[self._piece :]
        self._now_s += 1e-4 if chunk else timeout_s
        return chunk

    def discard_input(self) -> None:
        self._input = b""

    def close(self) -> None:
        self.closed = True


@dataclass(frozen=True)
class _Noise:
    name: str
    heard: str
    """What comes instead of the bare answer."""


HARMLESS = [
    _Noise("clean", POS_1_IS_500),
    _Noise("garbage before", "00 55 ff 55 55 " + POS_1_IS_500),
    _Noise("echo before", ASK_POS_1 + POS_1_IS_500),
    _Noise("half an echo before", "55 55 01 03" + POS_1_IS_500),
    _Noise("doubled", POS_1_IS_500 + POS_1_IS_500),
    _Noise("cut one before", "55 55 01 05 1c f4" + POS_1_IS_500),
    _Noise("cut longer one before", "55 55 01 07 08 f4" + POS_1_IS_500),
    _Noise("damaged one before", "55 55 01 05 1c f4 02 e8" + POS_1_IS_500),
    _Noise("another servo before", POS_2_IS_500.replace("f4 01 e7", "00 00 dc") + POS_1_IS_500),
    _Noise("another reading before", "55 55 01 05 1b e8 1c da" + POS_1_IS_500),
    _Noise("a 55 too many", "55" + POS_1_IS_500),
    _Noise("late answer of another command behind", POS_1_IS_500 + "55 55 01 04 1a 1f c1"),
]


@pytest.mark.parametrize("piece", [1, 3, 1000], ids="pieces of {}".format)
@pytest.mark.parametrize("case", HARMLESS, ids=lambda case: case.name)
def test_reads_the_position_whatever_stands_around_it(case: _Noise, piece: int) -> None:
    line = _ScriptedLine([(ASK_POS_1, case.heard)], piece=piece)
    assert LxBus(line).positions([1]) == {1: 500}
    assert not line.script


USELESS = [
    _Noise("silence", SILENT),
    _Noise("echo only", ASK_POS_1),
    _Noise("damaged", "55 55 01 05 1c f4 02 e8"),
    _Noise("cut", "55 55 01 05 1c f4 01"),
    _Noise("another servo", POS_2_IS_500),
    _Noise("another length", "55 55 01 04 1c f4 ea"),
]


@pytest.mark.parametrize("case", USELESS, ids=lambda case: case.name)
def test_asks_again_and_then_gives_up(case: _Noise) -> None:
    line = _ScriptedLine([(ASK_POS_1, case.heard), (ASK_POS_1, POS_1_IS_500)])
    assert LxBus(line).positions([1]) == {1: 500}
    line = _ScriptedLine([(ASK_POS_1, case.heard)] * 5)
    with pytest.raises(NoAnswerError, match="servo 1 does not answer"):
        LxBus(line).positions([1])
    assert not line.script
    assert line.now_s() < 1.1


def test_a_line_that_babbles_for_ever_is_left() -> None:
    class _Babbling(_ScriptedLine):
        def read(self, timeout_s: float) -> bytes:  # noqa: ARG002
            return b"\x55" * 64

    with pytest.raises(NoAnswerError, match="damaged or foreign bytes"):
        LxBus(_Babbling([(ASK_POS_1, SILENT)] * 5)).positions([1])


def test_what_arrived_before_the_question_is_no_answer() -> None:
    line = _ScriptedLine([(ASK_POS_1, POS_1_IS_500 + POS_1_IS_500), (ASK_POS_1, POS_1_IS_MINUS_3)], piece=8)
    bus = LxBus(line)
    assert bus.positions([1]) == {1: 500}
    assert bus.positions([1]) == {1: -3}


def test_positions_are_signed_and_in_order_of_the_servos() -> None:
    line = _ScriptedLine([(ASK_POS_2, POS_2_IS_500), (ASK_POS_1, POS_1_IS_MINUS_3)])
    assert LxBus(line).positions([2, 1]) == {2: 500, 1: -3}


def test_voltage_is_the_lowest() -> None:
    line = _ScriptedLine([("55 55 01 03 1b e0", "55 55 01 05 1b e8 1c da"), ("55 55 02 03 1b df", "55 55 02 05 1b 1c 1b a6")])
    assert LxBus(line).voltage_v([1, 2]) == pytest.approx(6.94)


def test_temperatures() -> None:
    line = _ScriptedLine([("55 55 01 03 1a e1", "55 55 01 04 1a 1f c1"), ("55 55 02 03 1a e0", "55 55 02 04 1a 29 b6")])
    assert LxBus(line).temperatures_c([1, 2]) == {1: 31, 2: 41}


def test_torque_is_told() -> None:
    assert LxBus(_ScriptedLine([(ASK_LOAD_1, LOAD_1_ON), (ASK_LOAD_2, LOAD_2_OFF)])).loaded([1, 2]) == {1: True, 2: False}


@pytest.mark.parametrize("echo", [True, False], ids=["echo", "no echo"])
def test_a_move_waits_everywhere_and_starts_at_once(echo: bool) -> None:
    line = _ScriptedLine([*ARMED, *STARTED], echo=echo)
    LxBus(line).move({1: 500, 2: 600}, 1.0)
    assert not line.script


def test_a_lost_target_is_sent_again_before_anything_moves() -> None:
    old = "55 55 01 07 08 f3 01 e8 03 10"
    line = _ScriptedLine([(WAIT_1, SILENT), (ASK_WAIT_1, old), *ARMED, *STARTED])
    LxBus(line).move({1: 500, 2: 600}, 1.0)
    assert not line.script


def test_a_servo_that_does_not_take_its_target_keeps_all_of_them_still() -> None:
    line = _ScriptedLine([*ARMED[:2], *[(WAIT_2, SILENT), (ASK_WAIT_2, "55 55 02 07 08 00 00 00 00 ee")] * 4])
    with pytest.raises(NoAnswerError, match="servo 2 answers but does not take commands"):
        LxBus(line).move({1: 500, 2: 600}, 1.0)
    assert not line.script


def test_a_servo_that_missed_the_start_is_started_by_number() -> None:
    missed = [(START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS), (ASK_MOVE_2, MOVE_2_IS_NOT)]
    line = _ScriptedLine([*ARMED, *missed, (START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS)])
    LxBus(line).move({1: 500, 2: 600}, 1.0)
    assert not line.script
    line = _ScriptedLine([*ARMED, *missed, *[(START_2, SILENT), (ASK_MOVE_2, MOVE_2_IS_NOT)] * 3])
    with pytest.raises(NoAnswerError, match="servo 2 did not start"):
        LxBus(line).move({1: 500, 2: 600}, 1.0)


def test_servos_that_never_tell_a_start_are_left_to_their_positions() -> None:
    one_by_one = [("55 55 01 03 0b f0", SILENT), (START_2, SILENT), (ASK_MOVE_1, MOVE_1_IS_NOT), (ASK_MOVE_2, MOVE_2_IS_NOT)]
    line = _ScriptedLine([*ARMED, (START_ALL, SILENT), (ASK_MOVE_1, MOVE_1_IS_NOT), (ASK_MOVE_2, MOVE_2_IS_NOT), *one_by_one * 3])
    LxBus(line).move({1: 500, 2: 600}, 1.0)
    assert not line.script


@pytest.mark.parametrize(
    ("targets", "duration_s", "says"),
    [
        ({1: 500, 2: 1001}, 1.0, "position 1001 of servo 2"),
        ({1: -1}, 1.0, "position -1 of servo 1"),
        ({1: 500}, 30.001, "outside 0 to 30 s"),
        ({1: 500}, -0.1, "outside 0 to 30 s"),
        ({1: 500}, float("nan"), "outside 0 to 30 s"),
        ({254: 500}, 1.0, "servo number 254"),
    ],
)
def test_nothing_is_sent_that_must_not_be(targets: dict[int, int], duration_s: float, says: str) -> None:
    line = _ScriptedLine([])
    with pytest.raises(UnsafeError, match=says):
        LxBus(line).move(targets, duration_s)


def test_the_limits_themselves_may_be_sent() -> None:
    check_move({0: 0, 253: 1000}, 30.0)
    check_move({1: 500}, 0.0)


def test_torque_is_switched_until_it_reads_so() -> None:
    lost = [("55 55 01 04 1f 01 da", SILENT), (ASK_LOAD_1, LOAD_1_OFF)]
    line = _ScriptedLine([*lost, ("55 55 01 04 1f 01 da", SILENT), (ASK_LOAD_1, LOAD_1_ON)])
    LxBus(line).load([1], True)
    assert not line.script


def test_torque_off_reaches_the_others_when_one_is_silent() -> None:
    silent = [("55 55 01 04 1f 00 db", SILENT), *[(ASK_LOAD_1, SILENT)] * 5]
    line = _ScriptedLine([*silent, ("55 55 02 04 1f 00 da", SILENT), (ASK_LOAD_2, LOAD_2_OFF)])
    with pytest.raises(NoAnswerError, match="servo 1"):
        LxBus(line).load([1, 2], False)
    assert not line.script


def test_stop_asks_nothing() -> None:
    line = _ScriptedLine([("55 55 01 03 0c ef", SILENT), ("55 55 02 03 0c ee", SILENT)] * 2)
    LxBus(line).stop([1, 2])
    assert not line.script


def test_echo_is_found_out_and_told() -> None:
    for echo, words in ((True, "LX servo bus with echo"), (False, "LX servo bus without echo")):
        bus = LxBus(_ScriptedLine([(ASK_POS_1, POS_1_IS_500)], echo=echo))
        assert bus.describe() == "LX servo bus"
        bus.positions([1])
        assert bus.describe() == words


def test_silence_of_the_adapter_is_told_from_silence_of_a_servo() -> None:
    with pytest.raises(NoAnswerError, match="not even the adapter's echo"):
        LxBus(_ScriptedLine([(ASK_POS_1, SILENT)] * 5), echo="yes").positions([1])
    with pytest.raises(NoAnswerError, match="check the servos' supply"):
        LxBus(_ScriptedLine([(ASK_POS_1, SILENT)] * 5, echo=True), echo="yes").positions([1])
    with pytest.raises(NoAnswerError, match="check the servos' supply"):
        LxBus(_ScriptedLine([(ASK_POS_1, SILENT)] * 5), echo="no").positions([1])


def test_close_closes_the_line() -> None:
    line = _ScriptedLine([])
    LxBus(line).close()
    assert line.closed


def test_frames_of_the_manual() -> None:
    assert frame(1, 1, bytes.fromhex("f4 01 e8 03")).hex(" ") == "55 55 01 07 01 f4 01 e8 03 16"
    assert frame(254, 14).hex(" ") == "55 55 fe 03 0e f0"
    assert find_reply(bytes.fromhex("55 55 01 04 0e 01 eb"), 1, 14, 1) == b"\x01"


def by_hand(counts: int) -> bytes:
    """Return the answer of servo 1 about its position."""
    low, high = counts & 0xFF, counts >> 8 & 0xFF
    return bytes([0x55, 0x55, 0x01, 0x05, 0x1C, low, high, 255 - (0x01 + 0x05 + 0x1C + low + high) % 256])


POSITIONS = st.integers(-32768, 32767)
ECHO = bytes.fromhex(ASK_POS_1)
RUBBISH = st.one_of(
    st.binary(max_size=12),
    st.just(ECHO),
    st.lists(st.sampled_from([0x55, 0x01, 0x05, 0x1C]), max_size=12).map(bytes),
    st.integers(0, 7).map(lambda size: bytes.fromhex(POS_1_IS_500)[:size]),
    st.just(bytes.fromhex(POS_2_IS_500)),
)


@given(before=st.lists(RUBBISH, max_size=4), counts=POSITIONS, times=st.integers(1, 3), cut=st.integers(0, 7))
def test_finds_the_answer_in_any_rubbish(before: list[bytes], counts: int, times: int, cut: int) -> None:
    answer = by_hand(counts)
    heard = b"".join(before) + answer * times + answer[:cut]
    assert find_reply(heard, 1, 28, 2) == answer[5:7]


@given(counts=POSITIONS, at=st.integers(0, 7), flip=st.integers(1, 255), echoes=st.integers(0, 2))
def test_never_believes_a_damaged_answer(counts: int, at: int, flip: int, echoes: int) -> None:
    damaged = bytearray(by_hand(counts))
    damaged[at] ^= flip
    assert find_reply(ECHO * echoes + bytes(damaged), 1, 28, 2) is None


@given(heard=st.binary(max_size=200))
def test_any_bytes_at_all_are_survived(heard: bytes) -> None:
    found = find_reply(heard, 1, 28, 2)
    assert found is None or by_hand(int.from_bytes(found, "little")) in heard
