"""The drivers of turntable and lamps: how the table approaches, what they believe and refuse, and random pairs of faults on the wire."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from rhizotwin.rig.rig_file import LightsPart, TurntablePart
from rhizotwin.rig.table.lights import MarlinLights
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.turntable import MarlinTurntable

PART = TurntablePart(speed_deg_per_s=30.0, approach_deg=3.6)


def on(board: Any, part: TurntablePart = PART, *, at_deg: float | None = None) -> MarlinTurntable:
    """Return a table that is prepared, and stands at an angle if it is given."""
    table = MarlinTurntable(MarlinLink(board), part, board.clock)
    table.prepare()
    if at_deg is not None:
        table.declare(at_deg)
    return table


def test_after_power_up_the_angle_is_unknown_until_declared(board: Any) -> None:
    table = on(board)
    assert board.motor.energised
    assert not table.knows_zero()
    with pytest.raises(LostError, match="the table's angle is unknown"):
        table.move_to(9.0)
    table.declare(117.25)
    assert board.x_deg == 477.25
    assert board.moves == []
    assert table.knows_zero()
    assert table.position_deg() == 117.25


def test_preparing_keeps_the_motor_on_for_good_and_moves_nothing(make_board: Any) -> None:
    board = make_board(start_deg=405.0)
    table = on(board)
    assert table.knows_zero()
    assert table.position_deg() == 45.0
    assert board.moves == []
    for text in ("M18 S0", "M17", "G90", "M204 T60", "M211 S0", "M155 S0"):
        assert text in board.done


def test_speed_and_acceleration_are_sent_and_sent_again(board: Any) -> None:
    table = on(board, replace(PART, acceleration_deg_per_s2=45.0, speed_deg_per_s=12.5), at_deg=0.0)
    table.move_to(9.0)
    assert "G1 X369 F750" in board.done  # per minute
    table.accelerate(7.5)
    table.prepare()
    assert [text for text in board.done if text.startswith("M204")] == ["M204 T45", "M204 T7.5", "M204 T7.5"]


WAYS = {
    "down": (0.0, (90.0, 45.0), (90.0, 41.4, 45.0), 3.6),
    "first move to where it stands, then up": (10.0, (10.0, 19.0, 20.0), (6.4, 10.0, 19.0, 20.0), 3.6),
    "by any number of turns": (0.0, (1080.0, 0.0), (1080.0, -3.6, 0.0), 3.6),
    "without approach": (0.0, (90.0, 45.0), (90.0, 45.0), 0.0),
}
"""Where the table stands, the angles that it is sent to, where its motor goes, and how far it approaches."""


@pytest.mark.parametrize(("start_deg", "angles", "goes", "approach_deg"), WAYS.values(), ids=WAYS)
def test_the_table_arrives_from_below(
    start_deg: float, angles: tuple[float, ...], goes: tuple[float, ...], approach_deg: float, board: Any
) -> None:
    table = on(board, replace(PART, approach_deg=approach_deg), at_deg=start_deg)
    for angle in angles:
        assert table.move_to(angle) == pytest.approx(angle, abs=0.0051)
        assert not board.motor.moving
    assert board.moves == pytest.approx([360.0 + goal for goal in goes])


def test_angles_below_the_least_are_refused(board: Any) -> None:
    table = on(board, at_deg=0.0)
    before = len(board.sent)
    for angle_deg in (-90.1, math.inf, math.nan):
        for action in (table.move_to, table.declare):
            with pytest.raises(UnsafeError, match="must be finite and at least -90 deg; add full turns"):
                action(angle_deg)
    assert len(board.sent) == before


@given(angle=st.floats(-90.0, 3600.0), approach=st.floats(0.0, 45.0), start=st.floats(-90.0, 3600.0))
def test_no_angle_looks_like_a_reset(make_board: Callable[..., Any], angle: float, approach: float, start: float) -> None:
    board = make_board()
    table = on(board, replace(PART, approach_deg=approach), at_deg=start)
    assert table.move_to(angle) == pytest.approx(angle, abs=0.0051)
    assert min(board.moves) >= 200.0
    assert table.knows_zero()
    assert "e" not in board.done[-3]  # no exponents in G-code


def damaged(digits: bytes) -> Callable[[bytes], list[tuple[float, bytes]]]:
    return lambda data: [(0.0, data.replace(b"X:405.00", b"X:" + digits, 1))]


def test_a_wrong_digit_is_not_believed(make_board: Any) -> None:
    board = make_board(start_deg=405.0)
    table = on(board)
    board.reply_faults = {board.printed: damaged(b"005.00"), board.printed + 4: damaged(b"415.00")}
    assert table.knows_zero()
    board.reply_faults = {board.printed + 2 * k: damaged(b"40%d.00" % k) for k in range(6)}
    with pytest.raises(NoAnswerError, match="a different angle at every reading"):
        table.position_deg()


def test_a_move_not_made_is_noticed(board: Any) -> None:
    """As a firmware whose software endstops stay on would do."""
    table, command = on(board, at_deg=0.0), board.command
    board.command = lambda line, now_s: command(line.replace("X450", "X400"), now_s)
    with pytest.raises(LostError, match=r"reports 40.00 deg after a move to 90.00 deg"):
        table.move_to(90.0)


@pytest.mark.parametrize(("banner", "at"), [("", 0), ("start\n Watchdog Reset\nMarlin 2.1.2.5\n", 2)], ids=["silent", "with banner"])
def test_a_reset_in_a_move_is_noticed_and_the_angle_is_gone(banner: str, at: int, board: Any) -> None:
    table = on(board, at_deg=0.0)
    board.resets = {len(board.sent) + at: banner}
    for action in (lambda: table.move_to(9.0), table.position_deg):
        with pytest.raises(LostError):
            action()
    table.prepare()
    assert not table.knows_zero()
    with pytest.raises(LostError, match="angle is unknown"):
        table.move_to(9.0)


def test_a_reset_that_the_lights_met_is_not_overlooked(board: Any) -> None:
    """They started the shared link anew: it is in order, but what the table knew is not."""
    table = on(board, at_deg=0.0)
    table.move_to(9.0)
    board.reset("")
    table._link.start()
    with pytest.raises(LostError, match="angle is unknown"):
        table.move_to(18.0)


def test_release_works_even_on_a_board_that_was_reset(board: Any) -> None:
    table = on(board, at_deg=9.0)
    table.release()
    assert not table.knows_zero()
    assert board.done.index("G92 X0") < board.done.index("M18")
    table.prepare()
    table.declare(9.0)
    board.reset("start\n")
    with pytest.raises(LostError):
        table.move_to(18.0)
    board.motor.energised = True
    table.release()
    assert not board.motor.energised


LAMPS = LightsPart(panel_strip=1, front_strip=0, panel_rgb=(255, 250, 240), front_rgb=(10, 20, 30), settle_s=0.5)
OFF = {"R": 0, "U": 0, "B": 0, "P": 0}


@pytest.fixture
def lights(board: Any) -> MarlinLights:
    """Return lamps whose link was started."""
    link = MarlinLink(board)
    link.start()
    return MarlinLights(link, LAMPS, board.clock)


def test_the_bytes_of_both_lamps(board: Any, lights: MarlinLights) -> None:
    """Green is U; M400 comes before, so that no step is disturbed; a level scales the brightness, not the colour."""
    before, begin_s = len(board.sent), board.clock.now_s()
    lights.set(panel=1.0, front=0.5)
    sent = [data.split(b" ", 1)[1].split(b"*")[0] for data in board.sent[before:]]
    assert sent == [b"M400", b"M150 S1 R255 U250 B240 P255", b"M150 S0 R10 U20 B30 P128", b"M114"]
    assert board.clock.now_s() - begin_s >= LAMPS.settle_s
    lights.set(panel=0.2, front=0.0)
    assert board.strips == {1: {"R": 255, "U": 250, "B": 240, "P": 51}, 0: OFF}
    lights.off()
    assert board.strips == {0: OFF, 1: OFF}


def test_an_interrupted_release_of_the_shutter_opens_its_contact(board: Any, lights: MarlinLights) -> None:
    lights._link.command = Mock(side_effect=[None, KeyboardInterrupt])
    with pytest.raises(KeyboardInterrupt):
        lights.release_shutter(60)
    assert board.sent[-1] == b"M42 P60 S0\n"


@pytest.mark.parametrize("level", [1.1, float("nan")])
def test_levels_beyond_the_limits_are_refused(level: float, lights: MarlinLights) -> None:
    with pytest.raises(ValueError, match="must be from 0 to 1"):
        lights.set(panel=0.0, front=level)


@pytest.mark.parametrize("at", [0, 2])
def test_off_survives_a_reset(at: int, board: Any, lights: MarlinLights) -> None:
    lights.set(panel=1.0, front=1.0)
    board.resets = {len(board.sent) + at: "start\n Brown out Reset\nMarlin 2.1.2.5\n"}
    lights.off()
    assert board.strips == {0: OFF, 1: OFF}
    assert board.done.count("M110 N0") == 2


def test_off_reaches_a_board_that_is_not_heard(board: Any, lights: MarlinLights) -> None:
    lights.set(panel=1.0, front=1.0)

    def deaf(timeout_s: float) -> bytes:
        board.clock.sleep(timeout_s)
        return b""

    board.read = deaf
    with pytest.raises(NoAnswerError):
        lights.off()
    assert board.strips == {0: OFF, 1: OFF}


def test_set_hides_neither_a_reset_nor_a_firmware_without_lamps(board: Any, lights: MarlinLights) -> None:
    board.unknown = ("M150",)
    with pytest.raises(RigError, match='does not support "M150 S1 R255 U250 B240 P255"; build Marlin'):
        lights.set(panel=1.0, front=1.0)
    board.resets = {len(board.sent): ""}
    with pytest.raises(LostError, match="was reset"):
        lights.set(panel=1.0, front=1.0)


def test_lamps_are_only_taken_for_set_when_they_are(board: Any, lights: MarlinLights) -> None:
    """A doubled ``ok`` passes for that of M150, whose own line was damaged on its way."""
    board.reply_faults = {board.printed: lambda data: [(0.0, data), (0.0005, data)]}
    board.request_faults = {len(board.sent) + 1: lambda data: [(0.0, data.replace(b"R255", b"R254"))]}
    lights.set(panel=1.0, front=0.0)
    assert board.strips[1] == {"R": 255, "U": 250, "B": 240, "P": 255}


Fault = Callable[[bytes], list[tuple[float, bytes]]]


def hit(kind: str, at: int, part: float, late_s: float) -> tuple[int, Fault]:
    """Return a fault of one line on the wire, with the line's number."""

    def become(data: bytes) -> list[tuple[float, bytes]]:
        where = min(int(part * len(data)), len(data) - 1)
        changed = data[:where] + bytes((data[where] ^ (1 << (at % 8)),)) + data[where + 1 :]
        return {
            "lost": [(0.0, b"")],
            "damaged": [(0.0, changed)],
            "doubled": [(0.0, data), (late_s / 100.0, data)],
            "late": [(late_s, data)],
            "cut": [(0.0, data[:where])],
            "glued": [(0.0, b"T:20.0 " + data)],
            "split": [(0.0, data[:where]), (0.2, data[where:])],
        }[kind]

    return at, become


KINDS = st.sampled_from(["lost", "damaged", "doubled", "late", "cut", "glued", "split"])
hits = st.builds(hit, KINDS, st.integers(0, 70), st.floats(0.0, 1.0), st.sampled_from((0.004, 0.05, 0.3, 0.7, 2.0, 9.0, 11.0, 30.0)))
requests = st.builds(hit, st.sampled_from(["lost", "damaged", "cut"]), st.integers(0, 40), st.floats(0.0, 1.0), st.just(0.0))
resets = st.dictionaries(st.integers(0, 40), st.sampled_from(("", "start\n Watchdog Reset\nMarlin 2.1.2.5\n")), max_size=1)


@settings(max_examples=200, deadline=None)
@given(
    replies=st.lists(hits, max_size=3),
    asked=st.lists(requests, max_size=2),
    resets=resets,
    speaks=st.sampled_from(({}, {"ok_after_resend": False}, {"advanced_ok": True}, {"keeps_alive": False}, {"greets": True})),
    angles=st.lists(st.sampled_from((0.0, 9.0, 18.0, 90.0, 351.0)), min_size=1, max_size=3),
)
def test_no_wrong_angle_is_ever_believed_and_nothing_hangs(
    make_board: Any, replies: list[Any], asked: list[Any], resets: dict[int, str], speaks: dict[str, bool], angles: list[float]
) -> None:
    board = make_board(reply_faults=dict(replies), request_faults=dict(asked), resets=resets, **speaks)
    table = MarlinTurntable(MarlinLink(board), replace(TurntablePart(), speed_deg_per_s=30.0), board.clock)
    try:
        table.prepare()
        assert not table.knows_zero()
        table.declare(4.5)
        assert board.x_deg == 364.5
        for angle in angles:
            begin_s = board.clock.now_s()
            assert table.move_to(angle) == angle == board.x_deg - 360.0
            assert not board.motor.moving
            assert board.clock.now_s() - begin_s < 200.0
        assert table.position_deg() == angles[-1]
        table.release()
        assert not board.motor.energised
        assert not table.knows_zero()
    except RigError:
        pass
    assert board.clock.now_s() < 700.0
