"""The lamps' driver."""

from typing import Any

import pytest

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.rig_file import BandPart, LightsPart
from rhizotwin.rig.table.lights import MarlinLights
from rhizotwin.rig.table.marlin import MarlinLink

PART = LightsPart(panel_strip=1, front_strip=0, panel_rgb=(255, 250, 240), front_rgb=(10, 20, 30), settle_s=0.5)
OFF = {"R": 0, "U": 0, "B": 0, "P": 0}


@pytest.fixture
def lights(board: Any) -> MarlinLights:
    """Return lamps whose link was started."""
    link = MarlinLink(board)
    link.start()
    return MarlinLights(link, PART, board.clock)


def test_the_bytes_of_both_lamps(board: Any, lights: MarlinLights) -> None:
    """Green is U; M400 comes before, so that no step is disturbed; a level scales the brightness, not the colour."""
    before, begin_s = len(board.sent), board.clock.now_s()
    lights.set(panel=1.0, front=0.5)
    assert [data.split(b" ", 1)[1].split(b"*")[0] for data in board.sent[before:]] == [
        b"M400",
        b"M150 S1 R255 U250 B240 P255",
        b"M150 S0 R10 U20 B30 P128",
        b"M114",
    ]
    assert board.clock.now_s() - begin_s >= PART.settle_s
    lights.set(panel=0.2, front=0.0)
    assert board.strips == {1: {"R": 255, "U": 250, "B": 240, "P": 51}, 0: OFF}
    board.strips[1] = {}
    lights.set(panel=0.2, front=0.0)  # they cannot be read back: whoever saw them fail sets them once more
    assert board.strips[1]["P"] == 51
    lights.off()
    assert board.strips == {0: OFF, 1: OFF}


def test_levels_beyond_the_limits_are_refused(lights: MarlinLights) -> None:
    for panel, front in ((-0.1, 0.0), (0.0, 1.1), (float("nan"), 0.0)):
        with pytest.raises(ValueError, match="must be from 0 to 1"):
            lights.set(panel=panel, front=front)


def test_the_link_is_started_when_it_was_not(board: Any, make_board: Any) -> None:
    MarlinLights(MarlinLink(board), PART, board.clock).set(panel=1.0, front=0.0)
    assert board.strips[1]["P"] == 255
    other = make_board()
    MarlinLights(MarlinLink(other), PART, other.clock).off()
    assert other.strips == {0: OFF, 1: OFF}


@pytest.mark.parametrize("at", range(4))
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
    lights.close()
    assert board.closed == 1


def test_a_band_has_its_colours_and_alone_its_output(board: Any) -> None:
    red, nir = BandPart(name="red", front_rgb=(255, 0, 0)), BandPart(name="nir", output=1)
    lights = MarlinLights(MarlinLink(board), PART, board.clock, bands=(red, nir, BandPart(name="uv", output=3)))
    lights.set(panel=0.0, front=1.0, band=red)
    assert board.strips == {1: OFF, 0: {"R": 255, "U": 0, "B": 0, "P": 255}}
    assert board.outputs == {1: 0, 3: 0}
    lights.set(panel=0.0, front=0.0, band=nir)
    assert board.outputs == {1: 255, 3: 0}
    lights.set(panel=1.0, front=1.0)
    assert board.outputs == {1: 0, 3: 0}
    lights.set(panel=0.0, front=0.0, band=nir)
    lights.off()
    assert board.outputs == {1: 0, 3: 0}
