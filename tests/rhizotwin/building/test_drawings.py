"""Drawings show what is seen at its true size; files hold the solids; the wiring names the pins of the rig file."""

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from rhizotwin.building import wiring
from rhizotwin.building.line_drawing import CORNER, FRONT, TOP, draw
from rhizotwin.building.measures import Measures, load_measures
from rhizotwin.building.pot import canister_ring
from rhizotwin.building.rig_parts import thesis_rig
from rhizotwin.building.write import stl_bytes, write_parts
from rhizotwin.rig.printing.print_page import Text
from rhizotwin.rig.rig_file import HatPart
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

CUBE = Manifold.cube((30.0, 20.0, 10.0))


def length_mm(strokes: list[np.ndarray]) -> float:
    return float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in strokes))


def test_a_box_shows_its_visible_edges_and_hides_what_is_behind() -> None:
    edges = [np.linalg.norm(CORNER.axes[:2] @ vector) for vector in np.diag([30.0, 20.0, 10.0])]
    assert length_mm(draw(CUBE, CORNER).strokes_mm) == pytest.approx(3.0 * sum(edges), rel=0.02)  # nine of twelve
    front = draw(CUBE, FRONT)
    np.testing.assert_allclose(front.size_mm, [30.0, 10.0])
    assert [line for line in front.strokes_mm if (np.abs(line - [15.0, 5.0]) < [14.0, 4.0]).all(axis=1).any()] == []
    behind = Manifold.compose([CUBE, Manifold.cube((4.0, 4.0, 4.0)).translate((10.0, 8.0, -8.0))])
    assert length_mm(draw(behind, TOP).strokes_mm) == pytest.approx(length_mm(draw(CUBE, TOP).strokes_mm), rel=0.01)


def test_a_file_holds_the_closed_solid() -> None:
    read = trimesh.load(io.BytesIO(stl_bytes(CUBE)), file_type="stl")
    assert isinstance(read, trimesh.Trimesh)
    assert read.is_watertight
    assert read.volume == pytest.approx(6000.0)


def test_the_hat_is_wired_as_the_rig_file_says() -> None:
    hat = HatPart(step_pin=5, panel_pin=12)
    starts = {wire.start: wire.end for wire in wiring.hat_diagram(hat).wires}
    assert starts["Raspberry Pi", "GPIO5"] == ("DRV8825", "STEP")
    assert starts["Raspberry Pi", "GPIO12"] == (wiring.SHIFTER, "1A")
    page = wiring.wiring_pages(replace(hat, microsteps=16))["hat"]
    texts = [ink.text for ink in page.parts if isinstance(ink, Text)]
    assert {"GPIO5", "GPIO12", "MODE2"} <= set(texts)
    assert any("1/16 step" in text for text in texts)


def test_measures_of_ones_own(tmp_path) -> None:
    path = tmp_path / "measures.toml"
    path.write_text("fit_mm = 0.2\n")
    assert load_measures(path) == Measures(fit_mm=0.2)
    path.write_text("fitt_mm = 0.2\n")
    with pytest.raises(UserError, match=r"line 1.*fitt_mm"):
        load_measures(path)


def test_one_part_alone_is_the_one_of_the_whole(tmp_path) -> None:
    known = {"rig": thesis_rig(), "measures": Measures(), "bed_mm": (220.0, 220.0, 250.0)}
    (ring,) = write_parts(Scene(), tmp_path / "ring", names=("canister_ring",), **known)
    assert ring.name == "canister_ring"
    names = {"canister_ring.stl", "canister_ring.svg", "parameters.csv", "parameters.json"}
    assert {path.name for path in (tmp_path / "ring").rglob("*.*")} == names
    (stored,) = (tmp_path / "ring").rglob("*.stl")
    assert stored.read_bytes() == stl_bytes(canister_ring(Scene(), Measures()).printed)
    with pytest.raises(UserError, match="the part 'nose' is unknown; choose from net_pot, "):
        write_parts(Scene(), tmp_path / "nose", names=("nose",), **known)
    assert not (tmp_path / "nose").exists()
