"""The reliability of a corrected result: one cause of uncertainty and one check for all corrections."""

from pathlib import Path

import pytest

from rhizotwin.corrections import against_pictures, corrected, log
from rhizotwin.corrections.session import Session
from tests.rhizotwin.plant import Plant


@pytest.mark.parametrize("roots", [(1, 1), (0, 0)], ids=["laterals", "main root and a lateral"])
def test_all_corrections_are_one_cause_and_one_check(plant: Plant, tmp_path: Path, roots: tuple[int, int]):
    """Root 0 is so large that its deletion contradicts the pictures; what was root 2 or 1 is then root 1 or 0."""
    source, found, first_mm3 = plant.result, against_pictures.Comparison(0.0, 0.0), Session(plant.result).summary["volume_mm3"]
    for root, name in zip(roots, ("once", "twice"), strict=True):
        session = Session(source)
        session.do(log.edit("delete roots", roots=[root]))
        found += against_pictures.compare(session, None)
        source, summary = tmp_path / name, corrected.write(session, tmp_path / name)
        assert found.missed > 0.01
        assert against_pictures.recorded(summary).missed == pytest.approx(found.missed)
        assert against_pictures.recorded(summary).surplus == pytest.approx(found.surplus)
        (term,) = [one for one in summary["volume_budget"] if one["name"] == "corrections"]
        assert term["more_mm3"] == pytest.approx(found.missed * first_mm3)
        (check,) = [one for one in summary["checks"] if one["name"] == "corrections"]
        assert check["value"] == pytest.approx(found.check().value)
        assert summary["volume_verdict"].count("because of the corrections") == (found.check().state == "bad")
    assert found.check().state == ("fair" if roots == (1, 1) else "bad")


def test_a_corrected_result_that_is_written_again_keeps_its_reliability(plant: Plant, tmp_path: Path):
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=[1]))
    before, after = corrected.write(session, tmp_path / "once"), corrected.write(Session(tmp_path / "once"), tmp_path / "again")
    assert after["checks"] == before["checks"]
    assert len(after["volume_budget"]) == len(before["volume_budget"])
