"""Written RSML files against a schema of the format, by a validator; and a schema that refuses what is wrong."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xmlschema

from rhizotwin.scenes.rsml import Root, write_rsml
from rhizotwin.scenes.rsml_reader import read_rsml

TAP = Root(
    points_mm=np.array([[0.0, 1e-7, -1.0], [0.0, 0.0, -2.0], [1.5e-16, 123456789.25, -40.0]]),
    diameters_mm=np.array([0.5, 1e-5, 0.0]),
    order=0,
    parent=-1,
    label='tap <&">ß',
)
LATERAL = Root(points_mm=np.array([[0.0, 0.1, -2.0], [5.0, 0.0, -2.0]]), diameters_mm=np.array([0.2, 0.1]), order=1, parent=0)
SECOND = Root(points_mm=LATERAL.points_mm + 1.0, diameters_mm=LATERAL.diameters_mm, order=2, parent=1, tip_seen=False)


def test_written_file_is_valid_and_exact(tmp_path: Path) -> None:
    """A taproot, a lateral of it and one of that, with numbers that tempt to exponents."""
    schema = xmlschema.XMLSchema(Path(__file__).parent / "data" / "rsml.xsd")
    path = tmp_path / "roots.rsml"
    write_rsml(path, [TAP, LATERAL, SECOND], modified=datetime(2024, 1, 2, tzinfo=UTC))
    schema.validate(path)
    for root, original in zip(read_rsml(path), (TAP, LATERAL, SECOND), strict=True):
        np.testing.assert_array_equal(root.points_mm, original.points_mm)
        np.testing.assert_array_equal(root.diameters_mm, original.diameters_mm)
    text = path.read_text(encoding="utf-8")
    assert "<last-modified>2024-01-02T00:00:00+00:00</last-modified>" in text
    assert [part.split('"')[1] for part in text.split("<parent-node value=")[1:]] == ["0", "1", "0"]  # where laterals leave
    assert schema.is_valid(text)
    for good, bad in (('z="-2.0"', 'z="-2e0"'), ('id="1.2"', 'id="1.1"'), ("<geometry>", "<functions/><geometry>"), (' y="', ' w="')):
        assert good in text
        assert not schema.is_valid(text.replace(good, bad, 1))  # the schema refuses what is wrong
