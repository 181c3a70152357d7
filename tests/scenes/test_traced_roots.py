"""Traced roots as files have them: gaps that the file closes, stretches that several roots share."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.scenes import traced_roots
from rhizotwin.scenes.rsml import Root, length_mm
from rhizotwin.scenes.rsml_reader import read_file

FILE = """<rsml><metadata><unit>mm</unit></metadata><scene><plant><root><geometry><polyline>
<point x="0" y="0" z="1"/><point x="0" y="0" z="-5"/><point x="0" y="0" z="-11"/><point x="0" y="0" z="-20"/><point x="0" y="0" z="-30"/>
</polyline></geometry><root><properties>{node}</properties><geometry><polyline>
<point x="4" y="0" z="{z}"/><point x="14" y="0" z="{z}"/></polyline></geometry></root></root></plant></scene></rsml>"""


def line(*points: tuple[float, float, float], parent: int = -1, diameter_mm: float = 1.0) -> Root:
    corners = np.array(points, dtype=np.float64)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1])) + 1)
    nodes = np.stack([np.interp(at, along, corners[:, k]) for k in range(3)], axis=1)
    return Root(points_mm=nodes, diameters_mm=np.full(len(nodes), diameter_mm), order=0 if parent < 0 else 1, parent=parent)


GAPS = {
    "stated": ('<parent-node value="3"/>', -21, -20.0),
    "counted from 1, as in RSWMS": ('<parent-node value="4.0"/>', -21, -20.0),
    "not stated, one point missing": ("", -21, -20.0),
    "stated node far away": ('<parent-node value="0"/>', -21, -20.0),
    "too far for a missing point": ('<parent-node value="99"/>', -300, None),
}


@pytest.mark.parametrize(("node", "z_mm", "closed_mm"), GAPS.values(), ids=GAPS)
def test_a_gap_is_closed_to_a_node_of_the_parent(tmp_path: Path, node: str, z_mm: int, closed_mm: float | None) -> None:
    (tmp_path / "gap.rsml").write_text(FILE.format(node=node, z=z_mm))
    roots, count = traced_roots.close_gaps(read_file(tmp_path / "gap.rsml", diameter_mm=0.5))
    assert count == (closed_mm is not None)
    assert roots[1].points_mm[0] == pytest.approx([4.0, 0.0, z_mm] if closed_mm is None else [0.0, 0.0, closed_mm])
    assert len(roots[1].diameters_mm) == len(roots[1].points_mm)


def test_single_points_of_cplantbox_are_connected_as_stated(tmp_path: Path) -> None:
    text = FILE.format(node='<parent-node value="3"/>', z=-21).replace('<point x="14" y="0" z="-21"/>', "")
    nested = '<root><properties><parent-node value="0"/></properties><geometry><polyline><point x="4" y="5" z="-21"/></polyline></geometry>'
    (tmp_path / "single.rsml").write_text(text.replace("</root></root>", f"{nested}</root></root></root>"))
    file = read_file(tmp_path / "single.rsml", diameter_mm=0.5)
    assert [root.points_mm.tolist() for root in file.roots[1:]] == [[[0, 0, -20], [4, 0, -21]], [[4, 0, -21], [4, 5, -21]]]
    assert "2 roots with a single point were connected" in file.notes[0]


def test_the_longest_thick_root_is_the_main_root() -> None:
    tap, fine = line((0, 0, -10), (0, 0, -60)), line((0, 0, -10), (200, 0, -10), diameter_mm=0.3)
    assert traced_roots.main_root([fine, tap, line((0, 0, -10), (0, 0, -20), diameter_mm=2.0)]) is tap
    assert traced_roots.growth_direction(tap) == pytest.approx([0.0, 0.0, -25.0])


def test_a_stretch_that_two_roots_share_counts_once() -> None:
    first = line((0, 0, -10), (0, 0, -60))
    second = line((0, 0, -10), (0, 0, -30), (20, 0, -50))  # traced from the base, as some programs do
    kept, shared_mm = traced_roots.merge_shared_stretches([first, second])
    assert shared_mm == pytest.approx(20.0, abs=0.5)
    assert length_mm(kept) == pytest.approx(50.0 + 800.0**0.5, abs=0.5)
    assert (kept[1].parent, kept[1].order) == (0, 1)
    assert kept[1].points_mm[0] == pytest.approx([0.0, 0.0, -30.0], abs=0.3)
    assert kept[1].points_mm[-1] == pytest.approx([20.0, 0.0, -50.0])


def test_a_root_traced_twice_is_left_out_and_its_laterals_stay() -> None:
    first = line((0, 0, -10), (0, 0, -60))
    again, lateral = replace(first), line((0, 0, -40), (30, 0, -40), parent=1, diameter_mm=0.4)
    kept, shared_mm = traced_roots.merge_shared_stretches([first, again, lateral])
    assert len(kept) == 2
    assert shared_mm == pytest.approx(50.0)
    assert kept[1].parent == 0


def test_roots_that_cross_or_run_side_by_side_stay_as_they_are() -> None:
    down, across = line((0, 0, -10), (0, 0, -60)), line((-20, 0, -35), (20, 0, -35), diameter_mm=0.6)
    beside = line((1.0, 0, -10), (1.0, 0, -60))  # it touches the first: a diameter apart
    kept, shared_mm = traced_roots.merge_shared_stretches([down, across, beside])
    assert shared_mm == 0.0
    assert [len(root.points_mm) for root in kept] == [len(root.points_mm) for root in (down, across, beside)]
