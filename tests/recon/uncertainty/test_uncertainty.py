"""The volume's error budget: how terms add up and are calibrated, the verdict, and what tubes and silhouettes leave open."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Grid, Hull, Leaves
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.hull.trimming import TrimmedHull
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import calibration, occlusion, solid_uncertainty
from rhizotwin.recon.uncertainty.budget import Budget, Term, part_interval
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration, find_calibration
from rhizotwin.scenes.model import Scene
from tests.recon.hull import blocks, exact_pictures


def term(less_mm3: float, more_mm3: float, name: str = "outlines") -> Term:
    return Term(name=name, less_mm3=less_mm3, more_mm3=more_mm3, why=f"of the {name}")


def budget_of(*terms: Term, **changes: object) -> Budget:
    return Budget(**({"volume_mm3": 100.0, "terms": terms, "views": 40} | changes))


def test_terms_add_in_quadrature() -> None:
    assert budget_of(term(3.0, 3.0), term(4.0, 4.0)).interval_mm3 == pytest.approx((95.0, 105.0))
    assert budget_of(term(3.0, 6.0), term(4.0, 8.0)).interval_mm3 == pytest.approx((95.0, 111.0)), "what is expected as it is"
    assert budget_of(term(0.0, 6.0)).interval_mm3 == pytest.approx((100.0, 106.0))
    behind = Term(name="occluded", less_mm3=0.0, more_mm3=6.0, why="roots continue behind the net pot")
    assert budget_of(behind, term(4.0, 4.0)).interval_mm3 == pytest.approx((96.0, 110.0)), "expected in full"
    assert budget_of(term(200.0, 1.0)).interval_mm3 == pytest.approx((0.0, 101.0)), "never below nothing"


@pytest.mark.parametrize("even", [0.0, 10.0])
def test_the_interval_holds_what_is_one_sided_nine_times_of_ten(even: float) -> None:
    """A root may end anywhere on a hidden way of 6: nine times of ten within 5.4 of it, and other causes are even."""
    rng = np.random.default_rng(2)
    true = 100.0 + rng.uniform(0.0, 6.0, 100_000) + rng.normal(0.0, even / 1.645, 100_000)
    low, high = budget_of(term(0.0, 5.4), term(even, even)).interval_mm3
    assert np.mean((low <= true) & (true <= high)) + 0.005 >= 0.9


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"views": TrustSettings().least_views - 1}, "only 7 views"),
        ({"terms": (term(1.0, 1.0), term(2.0, 40.0, "missing roots"))}, "of the missing roots"),
        ({"terms": (term(20.0, 0.0, "hull"), term(20.0, 0.0, "faces"), term(0.0, 24.0, "missing roots"))}, "of the hull"),
    ],
    ids=["views", "interval", "side"],
)
def test_what_is_no_measurement_is_said_with_its_cause(changes: dict[str, object], says: str) -> None:
    good = budget_of(term(3.0, 4.0))
    assert good.objections == ()
    assert "the true volume is 0.0970 to 0.1040 ml" in good.verdict
    budget = budget_of(term(3.0, 3.0), **changes)
    assert budget.verdict.startswith("this scan cannot give a volume: ")
    assert says in budget.verdict


def thin_grid(bottom_mm: float) -> Grid:
    return Grid(np.array([-2.0, -2.0, bottom_mm]), 0.2, 1, (10, 10, 10))


def occlusion_of(monkeypatch: pytest.MonkeyPatch, seen: Callable[[NDArray], NDArray], shape: Leaves) -> Term:
    """Return what may be hidden of a shape, where ten views see some points."""
    monkeypatch.setattr(occlusion, "_votes", lambda _bank, _maps, points: np.where(seen(points), 10, 0))
    bank = cast(ViewBank, SimpleNamespace(count=10, optics=Optics.from_scene(Scene())))
    maps = cast(DistanceMaps, None)  # only `_votes` looks into them
    return occlusion.occlusion_term(bank, maps, shape, shape, (), Water(70.0, -8.0, -150.0))


@pytest.mark.parametrize(
    ("top_mm", "seen", "hidden_mm3"),
    [
        (-11.8, lambda p: p[:, 2] < -11.5, 0.9 * 3.8 * 0.64),
        (-16.0, lambda p: p[:, 2] > -20.2, 0.9 * 130.0 * 0.64),
        (-16.0, lambda p: p[:, 0] < 0.5, 0.9 * (np.sqrt(70.0**2 - 0.2**2) - 0.4) * 0.8 * 4.0),
        (-16.0, lambda p: p[:, 2] > -40.0, 0.0),
    ],
    ids=["up to the water's top", "below", "beside", "ends in sight"],
)
def test_a_shape_may_go_on_wherever_sight_ends(
    monkeypatch: pytest.MonkeyPatch, top_mm: float, seen: Callable[[NDArray], NDArray], hidden_mm3: float
) -> None:
    """A block of 0.8 x 0.8 x 4 mm on the axis, in water from -8 mm down to -150 mm."""
    index = np.argwhere(np.ones((4, 4, 20), bool)) + np.array([8, 8, 0])
    hidden = occlusion_of(monkeypatch, seen, blocks.block(thin_grid(top_mm - 4.0), index))
    assert hidden.less_mm3 == 0.0
    assert hidden.more_mm3 == pytest.approx(hidden_mm3, rel=0.06)


@pytest.mark.parametrize(
    ("beyond_mm", "kept", "more"),
    [(0.0, 0.0, 1.0), (8.0, 0.0, 0.1), (8.0, 3.0, 0.75)],
    ids=["all round a ball", "a web beside it", "when three times as much was needed"],
)
def test_what_spheres_lose_to_the_least_outline_may_be_there(beyond_mm: float, kept: float, more: float) -> None:
    """A sphere fits into all outlines, the one with the largest error, too: what the hull has next to it counts in full, a web a tenth.

    Of a web beside which as much hull had to be kept, most may be there.
    """
    grid, centre, radius = Grid(np.array([38.0, -7.0, -77.0]), 0.25, 1, (28, 28, 28)), np.array([45.0, 0.0, -70.0]), 5.0
    every = np.argwhere(np.ones((56, 56, 56), bool))
    out_mm = np.linalg.norm(grid.origin_mm + (every + 0.5) * grid.size_mm - centre, axis=1)

    def within(reach_mm: NDArray[np.float64] | float) -> Leaves:
        occupancy = np.clip(0.5 + (reach_mm - out_mm) / grid.size_mm, 0.0, 1.0)
        return blocks.block(grid, every[occupancy > 0.0], occupancy[occupancy > 0.0])

    ball = within(radius)
    larger = within(np.where(every[:, 2] > 50, radius + beyond_mm, radius) if beyond_mm else radius + 0.06)  # the web is at the top alone
    spheres, none = Spheres(centre[None], np.array([radius])), Spheres(np.zeros((0, 3)), np.zeros(0))
    removed_mm3 = larger.volume_mm3() - ball.volume_mm3()
    trimmed = TrimmedHull(ball, spheres, none, kept * removed_mm3)
    hull = Hull(larger, larger.occupancy, larger.volume_mm3(), 0.0)
    scene = exact_pictures.ring_of(8)
    bank = ViewBank.pack(exact_pictures.views_of(scene), Optics.from_scene(scene))
    terms = solid_uncertainty.estimate_terms(bank, hull, hull.leaves, trimmed, slack_px=0.3, half_excess=0.0, missed=0.04, binary=False)
    trimmed_away, disagreeing = (next(one for one in terms if one.name == name) for name in ("trimmed away", "views disagree"))
    assert trimmed_away.less_mm3 == disagreeing.less_mm3 == 0.0
    assert disagreeing.more_mm3 == pytest.approx(ball.volume_mm3() * (1.04**1.5 - 1.0), rel=0.02)
    assert trimmed_away.more_mm3 == pytest.approx(more * (larger.volume_mm3() - ball.volume_mm3()), rel=0.1)


TERMS = (Term.symmetric("outlines", 3.0, "outlines"), Term(name="occluded", less_mm3=0.0, more_mm3=4.0, why="hidden"))


def find(**changes) -> Calibration:
    usual = {"views": 24, "px_a_mm": 2.0, "missed": 0.0, "translucent": False, "width_mm": None, "hidden": 0.0}
    return find_calibration(**usual | changes)


@pytest.mark.parametrize("changes", [{"views": 8}, {"px_a_mm": 12.0}])
def test_scans_unlike_the_calibration_scans_are_not_calibrated(changes) -> None:
    assert find(**changes) == NOT_CALIBRATED
    assert NOT_CALIBRATED.factor("volume_mm3") == 1.0


def test_the_first_regime_that_applies_is_used() -> None:
    assert find().regime == find(width_mm=2.0).regime == "clear"
    assert find(hidden=0.1).regime == "hidden parts"
    assert find(hidden=0.1, width_mm=0.3).regime == "thin roots"
    assert find(hidden=0.1, width_mm=0.3, translucent=True).regime == "translucent roots"
    assert find(hidden=0.1, width_mm=0.3, translucent=True, missed=0.2).regime == "inconsistent views"


def test_a_factor_scales_both_half_widths_and_those_of_parts() -> None:
    halved = Calibration(regime="test", factors={"volume_mm3": 0.5})
    plain, scaled = (Budget(volume_mm3=100.0, terms=TERMS, views=24, calibration=one) for one in (NOT_CALIBRATED, halved))
    assert scaled.interval_mm3 == pytest.approx(0.5 * (100.0 + np.array(plain.interval_mm3)))
    assert part_interval(TERMS, whole_mm3=100.0, part_mm3=100.0, calibration=halved) == pytest.approx(scaled.interval_mm3)


def test_factors_are_stored_positive_and_none_in_old_results() -> None:
    made = Calibration(regime="hidden top", factors={"tips": 1.5})
    assert Calibration.from_plain(made.plain()) == made
    assert Calibration.from_plain(None) == NOT_CALIBRATED
    assert calibration._table()
    assert all(factor > 0.0 for factors in calibration._table().values() for factor in factors.values())
