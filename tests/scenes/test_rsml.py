"""RSML files as they are in the wild, by the traps of the format, and the round trip of our own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root, plant_roots, write_rsml
from rhizotwin.scenes.rsml_reader import read_rsml

LINE = '<geometry><polyline><point x="0" y="0" z="-1"/><point x="0" y="0" z="-2"/><point x="0" y="0" z="-4"/></polyline></geometry>'
SAMPLES = '<sample value="0.5"/><sample value="0.4"/><sample value="0.1"/>'
THICK = f'<functions><function name="diameter" domain="polyline">{SAMPLES}</function></functions>'
MM = "<metadata><unit>mm</unit><resolution>1</resolution></metadata>"

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a file of one plant around some XML."""

    def file(roots: str, metadata: str = MM, *, plant: str = "<plant>{}</plant>") -> Path:
        path = tmp_path / "wild.rsml"
        path.write_text(f"<?xml version='1.0'?><rsml>{metadata}<scene>{plant.format(roots)}</scene></rsml>", encoding="utf-8")
        return path

    return file


def one(path: Path, unit: str | None = None, diameter_mm: float | None = None) -> Root:
    (root,) = read_rsml(path, unit=unit, diameter_mm=diameter_mm)
    return root


def test_schema_form_with_and_without_prefixes_and_capitals(write: Write) -> None:
    path = write(f'<root ID="1" label="tap" po:accession="PO:0020127">{LINE}{THICK}</root>')
    declared = '<rsml xmlns="http://x" xmlns:po="http://www.plantontology.org/xml-dtd/po.dtd">'
    for old, new in (("", ""), ("<rsml>", declared), ("<point x=", "<Point X="), (" y=", " Y=")):
        path.write_text(path.read_text().replace(old, new))
        root = one(path)
        np.testing.assert_array_equal(root.points_mm, [[0, 0, -1], [0, 0, -2], [0, 0, -4]])
        np.testing.assert_array_equal(root.diameters_mm, [0.5, 0.4, 0.1])
        assert (root.order, root.parent, root.label) == (0, -1, "tap")


def scaled(of: str, *values: str) -> str:
    return of.replace("0.5", values[0]).replace("0.4", values[1]).replace("0.1", values[2])


AS_TEXT = "<functions><function name='{}'><sample>0.5</sample><sample>0.4</sample><sample>0.1</sample></function></functions>"
THICKNESS = {
    "numbered function": THICK.replace("function ", "function1 ").replace("/function>", "/function1>"),
    "plural functions nested": THICK.replace("<function ", "<functions ").replace("</function>", "</functions>"),
    "radius": scaled(THICK.replace("diameter", "radius"), "0.25", "0.2", "0.05"),
    "radius with its unit": scaled(AS_TEXT.format("radius [m]"), "0.00025", "0.0002", "5e-5"),
    "capitals": THICK.replace('"diameter"', '"Diameter"').replace("sample", "Sample"),
    "diameter before radius": THICK.replace("diameter", "radius").replace("0.5", "7") + THICK,
}


@pytest.mark.parametrize("thickness", THICKNESS.values(), ids=THICKNESS.keys())
def test_thickness_in_many_forms(write: Write, thickness: str) -> None:
    np.testing.assert_allclose(one(write(f"<root>{LINE}{thickness}</root>")).diameters_mm, [0.5, 0.4, 0.1])


PROPERTIES = {
    "element with value": '<properties><type value="1"/><diameter value="0.3"/></properties>',
    "named property": '<properties><property name="diameter" value="0.3"/></properties>',
}


@pytest.mark.parametrize("properties", PROPERTIES.values(), ids=PROPERTIES.keys())
def test_one_diameter_for_the_whole_root(write: Write, properties: str) -> None:
    np.testing.assert_allclose(one(write(f"<root>{properties}{LINE}</root>")).diameters_mm, [0.3] * 3)


def test_property_with_a_defined_unit(write: Write) -> None:
    definition = "<property-definition><label>diameter</label><unit>cm</unit></property-definition>"
    metadata = MM.replace("</metadata>", f"<property-definitions>{definition}</property-definitions></metadata>")
    root = one(write(f'<root><properties><diameter value="0.03"/></properties>{LINE}</root>', metadata))
    assert root.diameters_mm[0] == pytest.approx(0.3)
    assert one(write(f"<root>{LINE}{THICK}</root>", metadata)).diameters_mm[0] == 0.5  # functions follow the points


def test_no_diameter_is_refused_unless_given(write: Write) -> None:
    path = write(f'<root label="tap">{LINE}</root><root>{LINE}{THICK}</root>')
    with pytest.raises(UserError, match=r'wild\.rsml: root 1 \("tap"\) has no diameter; .*--specimen-diameter-mm D, or with diameter_mm'):
        read_rsml(path)
    first, second = read_rsml(path, diameter_mm=0.7)
    np.testing.assert_array_equal(first.diameters_mm, [0.7] * 3)
    np.testing.assert_array_equal(second.diameters_mm, [0.5, 0.4, 0.1])


def test_lateral_does_not_lend_its_diameter_or_points(write: Write) -> None:
    with pytest.raises(UserError, match=r'root 1 .*"tap".* has no diameter'):
        read_rsml(write(f'<root label="tap">{LINE}<root>{LINE}{THICK}</root></root>'))
    (root,) = read_rsml(write(f"<root><root>{LINE}{THICK}</root></root>"))
    assert (root.order, root.parent) == (0, -1)


def test_empty_and_single_point_roots_are_left_out(write: Write) -> None:
    single = '<geometry><polyline><point x="0" y="0" z="0"/></polyline></geometry>'
    body = (
        f"<root/><root>{LINE}{THICK}<root><geometry/></root>"
        f"<root>{single}<root label='grandchild'>{LINE}{THICK}</root></root></root><root></root>"
    )
    tap, grandchild = read_rsml(write(body))
    assert (grandchild.order, grandchild.parent, grandchild.label) == (1, 0, "grandchild")
    assert tap.order == 0
    with pytest.raises(UserError, match="no root with at least two points"):
        read_rsml(write(f"<root/><root>{single}</root>"))


def test_several_plants_and_ids_of_any_case(write: Write) -> None:
    root = f'<root id="x">{LINE}{THICK}</root>'
    roots = read_rsml(write("", plant=f'<plant ID="1">{root}{{}}</plant><plant id="2">{root}</plant>'))
    assert [(r.order, r.parent) for r in roots] == [(0, -1), (0, -1)]
    assert len(read_rsml(write(root, plant="{}"))) == 1  # roots straight in the scene


UNITS = {
    "mm": ("<unit>mm</unit>", 1.0),
    "cm with resolution 1": ("<unit>cm</unit><resolution>1</resolution>", 10.0),
    "steps per cm": ("<unit>cm</unit><resolution>37.95</resolution>", 10.0 / 37.95),
    "m in steps of 0.1 mm": ("<unit>m</unit><resolution>0.0001</resolution>", 0.1),
    "um": ("<unit>µm</unit>", 1e-3),
}


@pytest.mark.parametrize(("metadata", "step_mm"), UNITS.values(), ids=UNITS.keys())
def test_units(write: Write, metadata: str, step_mm: float) -> None:
    root = one(write(f"<root>{LINE}{THICK}</root>", f"<metadata>{metadata}</metadata>"))
    np.testing.assert_allclose(root.points_mm[:, 2], np.array([-1, -2, -4]) * step_mm)
    np.testing.assert_allclose(root.diameters_mm, np.array([0.5, 0.4, 0.1]) * step_mm)


UNKNOWN = {
    "no metadata": "",
    "pixel": "<metadata><unit>pixel</unit><resolution>1</resolution></metadata>",
    "inch without dpi": "<metadata><unit>inch</unit></metadata>",
    "resolution 0": "<metadata><unit>cm</unit><resolution>0</resolution></metadata>",
}


@pytest.mark.parametrize("metadata", UNKNOWN.values(), ids=UNKNOWN.keys())
def test_unknown_unit_is_refused_unless_given(write: Write, metadata: str) -> None:
    path = write(f"<root>{LINE}{THICK}</root>", metadata)
    with pytest.raises(UserError, match=r"wild\.rsml: .*(with --specimen-unit, or as unit in a scene file|resolution)"):
        read_rsml(path)
    assert one(path, unit="cm").points_mm[0, 2] == -10.0
    assert one(path, unit="0.5 mm").points_mm[0, 2] == -0.5


def test_nonsense_unit_option(write: Write) -> None:
    path = write(f"<root>{LINE}{THICK}</root>")
    for unit in ("furlong", "", "0 mm", "-1 mm", "nan mm", "mm mm"):
        with pytest.raises(UserError, match="--specimen-unit"):
            read_rsml(path, unit=unit)


def test_unit_in_the_functions_name_serves_the_points(write: Write) -> None:
    path = write(f"<root>{LINE}{THICK.replace('diameter', 'radius [m]')}</root>", "")
    root = one(path)
    np.testing.assert_allclose(root.points_mm[:, 2], [-1000, -2000, -4000])
    np.testing.assert_allclose(root.diameters_mm, [1000, 800, 200])
    root = one(path, unit="cm")  # the option is about what is not marked
    assert root.points_mm[0, 2] == -10.0
    assert root.diameters_mm[0] == 1000.0


def test_two_dimensions_hang_down_at_depth_0(write: Write) -> None:
    flat = '<geometry><polyline><point x="3" y="1"/><point x="4" y="2"/><point x="5" y="7"/></polyline></geometry>'
    np.testing.assert_array_equal(one(write(f"<root>{flat}{THICK}</root>")).points_mm, [[3, 0, -1], [4, 0, -2], [5, 0, -7]])
    mixed = flat.replace('y="1"', 'y="1" z="0"')
    with pytest.raises(UserError, match="z of a point of root 1"):
        read_rsml(write(f"<root>{mixed}{THICK}</root>"))


def test_samples_are_one_a_point_or_spread_by_domain_and_position(write: Write) -> None:
    two = '<functions><function name="diameter" domain="{}"><sample {} value="1"/><sample {} value="0.4"/></function></functions>'
    with pytest.raises(UserError, match="2 samples for 3 points"):
        read_rsml(write(f"<root>{LINE}{two.format('polyline', '', '')}</root>"))
    np.testing.assert_allclose(one(write(f"<root>{LINE}{two.format('uniform', '', '')}</root>")).diameters_mm, [1.0, 0.8, 0.4])
    at = two.format("length", "position='1'", "position='3'")
    np.testing.assert_allclose(one(write(f"<root>{LINE}{at}</root>")).diameters_mm, [1.0, 1.0, 0.4])
    three = at.replace("<sample", "<sample position='0' value='2'/><sample", 1)  # as many as the points, but elsewhere
    np.testing.assert_allclose(one(write(f"<root>{LINE}{three}</root>")).diameters_mm, [2.0, 1.0, 0.4])
    halfway = three.replace("position='1'", "position='1.5'")
    np.testing.assert_allclose(one(write(f"<root>{LINE}{halfway}</root>")).diameters_mm, [2.0, 2.0 - 1.0 / 1.5, 0.4])


def test_a_tip_was_seen_unless_the_file_says_no(write: Write) -> None:
    for value, seen in (("false", False), ("False", False), ("0", False), ("true", True), ("1", True), ("", True)):
        properties = f'<properties><tip-seen value="{value}"/></properties>' if value else "<properties><tip-seen/></properties>"
        assert one(write(f"<root>{LINE}{THICK}{properties}</root>")).tip_seen is seen, value
    assert one(write(f"<root>{LINE}{THICK}</root>")).tip_seen


def test_impossible_diameters_and_points(write: Write) -> None:
    for bad, says in (("-0.5", "diameters must be above 0"), ("thick", "not a finite number"), ("nan", "not a finite number")):
        with pytest.raises(UserError, match=says):
            read_rsml(write(f"<root>{LINE}{THICK.replace('0.4', bad)}</root>"))
    for bad in ('x="one"', 'x="inf"', 'x=""', ""):
        with pytest.raises(UserError, match=r"x of a point of root 1 is"):
            read_rsml(write("<root>" + LINE.replace('x="0"', bad, 1) + THICK + "</root>"))


def test_what_is_no_rsml(tmp_path: Path) -> None:
    path = tmp_path / "wild.rsml"
    with pytest.raises(UserError, match="no such file"):
        read_rsml(path)
    for content in (
        b"",
        b"<html><body/></html>",
        f"<rsml><scene><plant><root>{LINE}".encode(),  # cut off
        b"<?xml version='1.0' encoding='utf-8'?><rsml a='\xff'/>",
    ):
        path.write_bytes(content)
        with pytest.raises(UserError, match=r"wild\.rsml: the file is not an RSML file"):
            read_rsml(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "secret").write_text("0.5")
    text = f"<?xml version='1.0'?><!DOCTYPE rsml [<!ENTITY x SYSTEM '{(tmp_path / 'secret').as_uri()}'>]><rsml>{MM}&x;</rsml>"
    (tmp_path / "wild.rsml").write_bytes(text.encode(encoding))
    with pytest.raises(UserError, match="document type"):
        read_rsml(tmp_path / "wild.rsml")


def test_deep_nesting_is_read(write: Write) -> None:
    depth = 3000
    roots = read_rsml(write(f"<root>{LINE}{THICK}" * depth + "</root>" * depth))
    assert roots[-1].order == depth - 1


numbers = st.floats(-200.0, 200.0)


@given(data=st.data())
@settings(deadline=None, max_examples=30)
def test_roots_survive_exactly(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    roots: list[Root] = []
    for index in range(data.draw(st.integers(1, 5))):
        n = data.draw(st.integers(2, 4))
        points = np.array(data.draw(st.lists(st.tuples(numbers, numbers, numbers), min_size=n, max_size=n)))
        diameters = np.array(data.draw(st.lists(st.floats(1e-3, 20.0), min_size=n, max_size=n)))
        parent = data.draw(st.integers(-1, index - 1))
        order = roots[parent].order + 1 if parent >= 0 else 0
        root = Root(points_mm=points, diameters_mm=diameters, order=order, parent=parent, label=f'r{index} <&">ß')
        sigma = np.array(data.draw(st.lists(st.floats(0.0, 2.0), min_size=n, max_size=n))) if data.draw(st.booleans()) else None
        roots.append(replace(root, tip_seen=data.draw(st.booleans()), diameter_sigma_mm=sigma))
    path = tmp_path_factory.mktemp("rsml") / "ours.rsml"
    write_rsml(path, roots)
    found = read_rsml(path)
    by_label = {root.label: root for root in found}
    assert len(found) == len(roots) == len(by_label)
    for root in roots:
        other = by_label[root.label]
        np.testing.assert_array_equal(other.points_mm, root.points_mm)
        np.testing.assert_array_equal(other.diameters_mm, root.diameters_mm)
        np.testing.assert_array_equal(other.diameter_sigma_mm, root.diameter_sigma_mm)
        assert (other.order, other.tip_seen) == (root.order, root.tip_seen)
        assert (found[other.parent].label if other.parent >= 0 else None) == (roots[root.parent].label if root.parent >= 0 else None)


def test_impossible_parents_are_refused(tmp_path: Path) -> None:
    points, diameters = np.array([[0.0, 0, -1], [0, 0, -2]]), np.array([0.5, 0.4])
    for parents in ((0,), (1, 0), (5,), (-2,)):
        with pytest.raises(ValueError):
            write_rsml(tmp_path / "a.rsml", [Root(points_mm=points, diameters_mm=diameters, order=0, parent=p) for p in parents])
    assert not list(tmp_path.iterdir())


def test_plants_have_elements_of_their_own_and_names_that_are_read_back(tmp_path: Path) -> None:
    tap = Root(points_mm=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -5.0]]), diameters_mm=np.ones(2), order=0, parent=-1, plant="B")
    roots = [tap, replace(tap, points_mm=tap.points_mm + 9.0, plant="A"), replace(tap, order=1, parent=0)]
    write_rsml(tmp_path / "two.rsml", roots)
    text = (tmp_path / "two.rsml").read_text()
    assert text.index('label="B"') < text.index('label="A"')
    read = read_rsml(tmp_path / "two.rsml")
    assert [(one.plant, one.parent) for one in read] == [("B", -1), ("B", 0), ("A", -1)]
    assert [one.parent for one in plant_roots(read, "B")] == [-1, 0]
    assert plant_roots(read, "C") == ()
