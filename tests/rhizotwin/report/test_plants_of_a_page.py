"""Several plants on a result's page: a plant has no volume where the whole has none."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.recon.results.by_plant import PlantResult
from rhizotwin.report import page
from rhizotwin.report.report_data import ReportData
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits, measure_traits
from tests.roots import straight


def of_roots(roots: Sequence[Root]) -> Traits:
    points_mm = np.concatenate([root.points_mm for root in roots])
    return measure_traits(roots, points_mm, volume_mm3=126.0 * len(roots), surface_mm2=251.0 * len(roots))


@pytest.mark.parametrize("trusted", [True, False])
def test_a_plant_has_a_volume_only_where_the_whole_has_one(trusted: bool) -> None:
    roots, plants = [straight((x, 0.0, -10.0), (x, 0.0, -50.0), 2.0, plant=name) for x, name in ((0.0, "A"), (9.0, "B"))], []
    known = {"volume_mm3": 126.0, "volume_interval_mm3": (120.0, 130.0), "open_mm": 0.0}
    for root in roots:
        found = PlantResult(subject=Subject(plant=root.plant), at_mm=(root.points_mm[0, 0], 0.0), traits=of_roots([root]), **known)
        plants.append(found.plain())
    volume = {"volume_trusted": trusted, "volume_verdict": "", "volume_mm3": 252.0, "volume_interval_mm3": (240.0, 260.0)}
    summary = volume | {"plants": plants, "settings": {}, "views": [], "volume_budget": {"focal": 0.01}}
    report = ReportData(Path("result"), summary, None)
    vars(report).update(roots=roots, traits=of_roots(roots))
    shown = page._plants(report)
    assert (" ml</td>" in shown) is trusted
    assert ("not reliable" in shown) is not trusted
    assert "the minimum distance of their roots is 7.00 mm" in shown
