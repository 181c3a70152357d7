"""RSML files as they are in the wild, by the traps of the format, and the round trip of our own."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import xmlschema

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root, plant_roots, write_rsml
from rhizotwin.scenes.rsml_reader import read_rsml

LINE = '<geometry><polyline><point x="0" y="0" z="-1"/><point x="0" y="0" z="-2"/><point x="0" y="0" z="-4"/></polyline></geometry>'
SAMPLES = '<sample value="0.5"/><sample value="0.4"/><sample value="0.1"/>'
THICK = f'<functions><function name="diameter" domain="polyline">{SAMPLES}</function></functions>'
MM = "<metadata><unit>mm</unit><resolution>1</resolution></metadata>"
ROOT = f"<root>{LINE}{THICK}</root>"

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:

    def file(roots: str, metadata: str = MM, *, plant: str = "<plant>{}</plant>") -> Path:
        path = tmp_path / "wild.rsml"
        path.write_text(f"<?xml version='1.0'?><rsml>{metadata}<scene>{plant.format(roots)}</scene></rsml>", encoding="utf-8")
        return path

    return file


def one(path: Path, unit: str | None = None, diameter_mm: float | None = None) -> Root:
    (root,) = read_rsml(path, unit=unit, diameter_mm=diameter_mm)
    return root


DECLARED = '<rsml xmlns="http://x" xmlns:po="http://www.plantontology.org/xml-dtd/po.dtd">'
SPELT = {"schema": ("", ""), "prefixes": ("<rsml>", DECLARED), "capital point": ("<point x=", "<Point X="), "capital y": (" y=", " Y=")}
SPELT["RootSystemTracker"] = ('<point x="0" y="0" z=', '<point coord_t="3" coord_x="0" coord_y="0" coord_z=')


@pytest.mark.parametrize(("old", "new"), SPELT.values(), ids=SPELT)
def test_schema_form_with_and_without_prefixes_and_capitals(write: Write, old: str, new: str) -> None:
    path = write(f'<root ID="1" label="tap" po:accession="PO:0020127">{LINE}{THICK}</root>')
    path.write_text(path.read_text().replace(old, new))
    root = one(path)
    np.testing.assert_array_equal(root.points_mm, [[0, 0, -1], [0, 0, -2], [0, 0, -4]])
    np.testing.assert_array_equal(root.diameters_mm, [0.5, 0.4, 0.1])
    assert (root.order, root.parent, root.label) == (0, -1, "tap")


def scaled(of: str, *values: str) -> str:
    return of.replace("0.5", values[0]).replace("0.4", values[1]).replace("0.1", values[2])


AS_TEXT = "<functions><function name='{}'><sample>0.5</sample><sample>0.4</sample><sample>0.1</sample></function></functions>"
DEFINITION = "<property-definition><label>diameter</label><unit>cm</unit></property-definition>"
DEFINED = MM.replace("</metadata>", f"<property-definitions>{DEFINITION}</property-definitions></metadata>")
TWO = '<functions><function name="diameter" domain="{}"><sample {} value="1"/><sample {} value="0.4"/></function></functions>'
AT = TWO.format("length", "position='1'", "position='3'")
THREE = AT.replace("<sample", "<sample position='0' value='2'/><sample", 1)
THICKNESS: dict[str, tuple[str, list[float]]] = {
    "numbered function": (THICK.replace("function ", "function1 ").replace("/function>", "/function1>"), [0.5, 0.4, 0.1]),
    "radius with its unit": (scaled(AS_TEXT.format("radius [m]"), "0.00025", "0.0002", "5e-5"), [0.5, 0.4, 0.1]),
    "diameter before radius": (THICK.replace("diameter", "radius").replace("0.5", "7") + THICK, [0.5, 0.4, 0.1]),
    "property, element with value": ('<properties><type value="1"/><diameter value="0.3"/></properties>', [0.3] * 3),
    "uniform": (TWO.format("uniform", "", ""), [1.0, 0.8, 0.4]),
    "as many as the points, but elsewhere": (THREE, [2.0, 1.0, 0.4]),
    "halfway": (THREE.replace("position='1'", "position='1.5'"), [2.0, 2.0 - 1.0 / 1.5, 0.4]),
    "0 of points that RootSystemTracker did not measure": (AS_TEXT.format("age"), [0.7] * 3),
}


@pytest.mark.parametrize(("thickness", "expected"), THICKNESS.values(), ids=THICKNESS)
def test_thickness_in_many_forms(write: Write, thickness: str, expected: list[float]) -> None:
    line = LINE.replace("<point", "<point diameter='0'")
    np.testing.assert_allclose(one(write(f"<root>{line}{thickness}</root>"), diameter_mm=0.7).diameters_mm, expected)


UNITS: dict[str, tuple[str, str, float, list[float]]] = {
    "cm with resolution 1": ("<metadata><unit>cm</unit><resolution>1</resolution></metadata>", THICK, 10.0, [5, 4, 1]),
    "steps per cm": ("<metadata><unit>cm</unit><resolution>40</resolution></metadata>", THICK, 0.25, [0.125, 0.1, 0.025]),
    "m in steps of 0.1 mm": ("<metadata><unit>m</unit><resolution>0.0001</resolution></metadata>", THICK, 0.1, [0.05, 0.04, 0.01]),
    "of a property": (DEFINED, '<properties><diameter value="0.03"/></properties>', 1.0, [0.3] * 3),
    "of a definition that fits": (DEFINED.replace("mm", "um"), THICK, 0.001, [5, 4, 1]),
    "SmartRoot's definition does not fit": (DEFINED, THICK.replace("0.", "10"), 1.0, [105, 104, 101]),
    "pixel(um)": ("<metadata><unit>pixel(um)</unit><size>76.0</size></metadata>", THICK, 0.076, [0.038, 0.0304, 0.0076]),
    "a function's serves the points": ("", THICK.replace("diameter", "radius [m]"), 1000.0, [1000, 800, 200]),
}


@pytest.mark.parametrize(("metadata", "thickness", "step_mm", "diameters_mm"), UNITS.values(), ids=UNITS)
def test_units(write: Write, metadata: str, thickness: str, step_mm: float, diameters_mm: list[float]) -> None:
    root = one(write(f"<root>{LINE}{thickness}</root>", metadata))
    np.testing.assert_allclose(root.points_mm[:, 2], np.array([-1, -2, -4]) * step_mm)
    np.testing.assert_allclose(root.diameters_mm, diameters_mm)


UNKNOWN = {
    "no metadata": "",
    "inch without dpi": "<metadata><unit>inch</unit></metadata>",
    "pixel": "<metadata><unit>pixel</unit><resolution>300</resolution></metadata>",
    "pixel(um) without size": "<metadata><unit>pixel(um)</unit></metadata>",
}


@pytest.mark.parametrize("metadata", UNKNOWN.values(), ids=UNKNOWN)
def test_unknown_unit_is_refused_unless_given(write: Write, metadata: str) -> None:
    path = write(ROOT, metadata)
    with pytest.raises(UserError, match=r"wild\.rsml: .*(with --specimen-unit, or as unit in a scene file|resolution)"):
        read_rsml(path)
    assert one(path, unit="cm").points_mm[0, 2] == -10.0
    assert one(path, unit="0.5 mm").points_mm[0, 2] == -0.5


@pytest.mark.parametrize("unit", ["furlong", "-1 mm"])
def test_nonsense_unit_option(write: Write, unit: str) -> None:
    with pytest.raises(UserError, match="--specimen-unit"):
        read_rsml(write(ROOT), unit=unit)


def test_no_diameter_is_refused_unless_given(write: Write) -> None:
    path = write(f'<root label="tap">{LINE}</root>{ROOT}')
    with pytest.raises(UserError, match=r'wild\.rsml: root 1 \("tap"\) has no diameter; .*--specimen-diameter-mm D, or with diameter_mm'):
        read_rsml(path)
    first, second = read_rsml(path, diameter_mm=0.7)
    np.testing.assert_array_equal(first.diameters_mm, [0.7] * 3)
    np.testing.assert_array_equal(second.diameters_mm, [0.5, 0.4, 0.1])


SINGLE = '<geometry><polyline><point x="0" y="0" z="0"/></polyline></geometry>'
FLAT = '<geometry><polyline><point x="3" y="1"/><point x="4" y="2"/><point x="5" y="7"/></polyline></geometry>'
REFUSED = {
    "diameter of a lateral only": (f'<root label="tap">{LINE}{ROOT}</root>', r'root 1 .*"tap".* has no diameter'),
    "no line": (f"<root/><root>{SINGLE}</root>", "no root with at least two points"),
    "z of some points": ("<root>" + FLAT.replace("<point", '<point z="0"', 1) + f"{THICK}</root>", "z of a point of root 1"),
    "too few samples": (f"<root>{LINE}{TWO.format('polyline', '', '')}</root>", "2 samples for 3 points"),
    "negative diameter": (ROOT.replace("0.4", "-0.5"), "diameters must be above 0"),
    "diameter in words": (ROOT.replace("0.4", "thick"), "not a finite number"),
    **{f"x: {bad}": (ROOT.replace('x="0"', bad, 1), "x of a point of root 1 is") for bad in ('x="inf"', "")},
}


@pytest.mark.parametrize(("roots", "says"), REFUSED.values(), ids=REFUSED)
def test_impossible_roots_are_refused(write: Write, roots: str, says: str) -> None:
    with pytest.raises(UserError, match=says):
        read_rsml(write(roots))


def test_roots_without_a_line_are_left_out(write: Write) -> None:
    grandchild = ROOT.replace("<root>", "<root label='grandchild'>")
    roots = read_rsml(write(f"<root/><root>{LINE}{THICK}<root><geometry/></root><root>{SINGLE}{grandchild}</root></root><root></root>"))
    assert [(root.order, root.parent, root.label) for root in roots] == [(0, -1, ""), (1, 0, "grandchild")]
    root = one(write(f"<root>{ROOT}</root>"))
    assert (root.order, root.parent) == (0, -1)


FLAT_FILES = {
    "own id, as RSWMS": [("3", "parent-branch", "2"), ("2", "parent-branch", "1"), ("1", "parent-branch", "1")],
    "-1 and decimals": [("3", "parentBranch", "2.0"), ("2", "parentBranch", "1.0"), ("1", "parentBranch", "-1")],
    "ids of OpenAlea": [("1.1.1", "Parent_ID", "1.1"), ("1.1", "Parent_ID", "1"), ("1", "age", "3")],
    "numbers from 1": [("", "parent", "2"), ("", "parent", "3"), ("", "parent", "0")],
    "numbers from 0": [("", "parent", "1"), ("", "parent", "2"), ("", "parent", "-1")],
}


@pytest.mark.parametrize("stated", FLAT_FILES.values(), ids=FLAT_FILES)
def test_flat_file_states_its_parents(write: Write, stated: list[tuple[str, str, str]]) -> None:
    roots = [
        f'<root {f"ID={own!r}" if own else ""} label="{2 - k}"><properties><{name}>{value}</{name}></properties>{LINE}{THICK}</root>'
        for k, (own, name, value) in enumerate(stated)
    ]
    read = read_rsml(write("".join(roots)))
    assert [(root.label, root.order, root.parent) for root in read] == [("0", 0, -1), ("1", 1, 0), ("2", 2, 1)]


WRONG_PARENTS = {"no root has this id": "17 22", "2 roots have this id": "12 22 23", "is its own ancestor": "13 22 31"}


@pytest.mark.parametrize(("says", "pairs"), WRONG_PARENTS.items(), ids=WRONG_PARENTS)
def test_impossible_parents_are_refused(write: Write, says: str, pairs: str) -> None:
    stated = "<root id='{}'><properties><parent-branch value='{}'/></properties>" + LINE + THICK + "</root>"
    with pytest.raises(UserError, match=says):
        read_rsml(write("".join(stated.format(*pair) for pair in pairs.split())))


def test_two_dimensions_hang_down_at_depth_0(write: Write) -> None:
    np.testing.assert_array_equal(one(write(f"<root>{FLAT}{THICK}</root>")).points_mm, [[3, 0, -1], [4, 0, -2], [5, 0, -7]])


def test_a_tip_was_seen_unless_the_file_says_no(write: Write) -> None:
    said = {f'<properties><tip-seen value="{value}"/></properties>': value in "true 1" for value in ("false", "true", "0", "1")} | {
        "": True
    }
    assert {text: one(write(f"<root>{LINE}{THICK}{text}</root>")).tip_seen for text in said} == said


NO_RSML = {
    "empty": b"",
    "cut off": f"<rsml><scene><plant><root>{LINE}".encode(),
    "not utf-8": b"<?xml version='1.0' encoding='utf-8'?><rsml a='\xff'/>",
}


@pytest.mark.parametrize("content", NO_RSML.values(), ids=NO_RSML)
def test_what_is_no_rsml(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "wild.rsml"
    with pytest.raises(UserError, match="no such file"):
        read_rsml(path)
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


def root_of(points: list[list[float]], diameters: list[float], *, order: int = 0, parent: int = -1, **options: object) -> Root:
    return Root(points_mm=np.array(points), diameters_mm=np.array(diameters), order=order, parent=parent, **options)


def test_written_file_is_valid_by_the_schema(tmp_path: Path) -> None:
    tap = root_of([[0.0, 1e-7, -1.0], [0.0, 0.0, -2.0], [1.5e-16, 123456789.25, -40.0]], [0.5, 1e-5, 0.0], label='tap <&">ß')
    lateral = root_of([[0.0, 0.1, -2.0], [5.0, 0.0, -2.0]], [0.2, 0.1], order=1, parent=0)
    second = root_of([[1.0, 1.1, -1.0], [6.0, 1.0, -1.0]], [0.2, 0.1], order=2, parent=1, tip_seen=False)
    tap = replace(tap, diameter_sigma_mm=np.array([0.1, 1 / 3, 0.0]))
    path = tmp_path / "roots.rsml"
    write_rsml(path, [tap, lateral, second], modified=datetime(2024, 1, 2, tzinfo=UTC))
    found = read_rsml(path)
    for read, own in zip(found, (tap, lateral, second), strict=True):
        np.testing.assert_array_equal([*read.points_mm.T, read.diameters_mm], [*own.points_mm.T, own.diameters_mm])
        assert (read.order, read.parent, read.label, read.tip_seen) == (own.order, own.parent, own.label, own.tip_seen)
    np.testing.assert_array_equal(found[0].diameter_sigma_mm, tap.diameter_sigma_mm)
    schema, text = xmlschema.XMLSchema(Path(__file__).parent / "data" / "rsml.xsd"), path.read_text(encoding="utf-8")
    schema.validate(text)
    assert "<last-modified>2024-01-02T00:00:00+00:00</last-modified>" in text
    assert [part.split('"')[1] for part in text.split("<parent-node value=")[1:]] == ["0", "1", "0"]  # where laterals leave
    assert [part.split('"')[1] for part in text.split("<tip-seen value=")[1:]] == ["1", "1", "0"]  # OpenAlea reads numbers only
    wrong = {'z="-2.0"': 'z="-2e0"', 'id="1.2"': 'id="1.1"', "<geometry>": "<functions/><geometry>", ' y="': ' w="'}
    assert [schema.is_valid(text.replace(good, bad, 1)) for good, bad in wrong.items()] == [False] * 4


def test_plants_have_elements_and_names_that_are_read_back(tmp_path: Path) -> None:
    tap = root_of([[0.0, 0.0, 0.0], [0.0, 0.0, -5.0]], [1.0, 1.0], plant="B")
    roots = [tap, replace(tap, points_mm=tap.points_mm + 9.0, plant="A"), replace(tap, order=1, parent=0)]
    write_rsml(tmp_path / "two.rsml", roots)
    text = (tmp_path / "two.rsml").read_text()
    assert text.index('label="B"') < text.index('label="A"')
    read = read_rsml(tmp_path / "two.rsml")
    assert [(one.plant, one.parent) for one in read] == [("B", -1), ("B", 0), ("A", -1)]
    assert [one.parent for one in plant_roots(read, "B")] == [-1, 0]
    assert plant_roots(read, "C") == ()
