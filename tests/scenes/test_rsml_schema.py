"""Written RSML files against a schema of the format, by a validator; and a schema that refuses what is wrong."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xmlschema

from rhizotwin.scenes.rsml import Root, read_rsml, write_rsml


@cache
def schema() -> xmlschema.XMLSchema:
    return xmlschema.XMLSchema(Path(__file__).parent / "data" / "rsml.xsd")


TAP = Root(
    points_mm=np.array([[0.0, 1e-7, -1.0], [0.0, 0.0, -2.0], [1.5e-16, 123456789.25, -40.0]]),
    diameters_mm=np.array([0.5, 1e-5, 0.0]),
    order=0,
    parent=-1,
    label='tap <&">ß',
)
LATERAL = Root(points_mm=np.array([[0.0, 0.1, -2.0], [5.0, 0.0, -2.0]]), diameters_mm=np.array([0.2, 0.1]), order=1, parent=0)
SECOND = Root(points_mm=LATERAL.points_mm + 1.0, diameters_mm=LATERAL.diameters_mm, order=2, parent=1, tip_seen=False)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """Return a file of a taproot, a lateral of it and one of that, with numbers that tempt to exponents."""
    write_rsml(tmp_path / "roots.rsml", [TAP, LATERAL, SECOND])
    return tmp_path / "roots.rsml"


def test_written_file_is_valid_and_exact(written: Path) -> None:
    schema().validate(written)
    found = read_rsml(written)
    for root, original in zip(found, (TAP, LATERAL, SECOND), strict=True):
        np.testing.assert_array_equal(root.points_mm, original.points_mm)
        np.testing.assert_array_equal(root.diameters_mm, original.diameters_mm)


def test_parent_nodes_are_where_laterals_leave(written: Path) -> None:
    text = written.read_text(encoding="utf-8")
    nodes = [part.split('"')[1] for part in text.split("<parent-node value=")[1:]]
    assert nodes == ["0", "1", "0"]


WRONG = {
    "exponent": ('z="-2.0"', 'z="-2e0"'),
    "id in capitals": ('id="1.2"', 'ID="1.2"'),
    "the same id twice": ('id="1.2"', 'id="1.1"'),
    "unknown unit": ("<unit>mm</unit>", "<unit>furlong</unit>"),
    "no time": ("T", " "),
    "unknown domain": ('domain="polyline"', 'domain="points"'),
    "functions before geometry": ("<geometry>", "<functions/><geometry>"),
    "point without y": (' y="', ' w="'),
}


@pytest.mark.parametrize(("good", "bad"), WRONG.values(), ids=WRONG.keys())
def test_schema_refuses(written: Path, good: str, bad: str) -> None:
    text = written.read_text(encoding="utf-8")
    assert good in text
    written.write_text(text.replace(good, bad, 1), encoding="utf-8")
    assert not schema().is_valid(written)
