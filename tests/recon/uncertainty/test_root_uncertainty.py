"""Length, tips and mean diameter against pictures: what is missing, surplus or too thick is seen and lies in the interval."""

import itertools

import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.uncertainty import root_residual, root_uncertainty
from rhizotwin.recon.uncertainty.root_uncertainty import Known
from rhizotwin.scenes.rsml import Root, length_mm, mean_diameter_mm
from tests.recon.hull.exact_pictures import ring_of
from tests.recon.strings import blank_of

SCENE = ring_of(6, (480, 360), first_deg=10.0)


def line(start, end, *, diameter_mm: float = 1.2, parent: int = 0) -> Root:
    points = np.linspace(start, end, 60)
    return Root(points_mm=points, diameters_mm=np.full(60, diameter_mm), order=min(parent + 1, 1), parent=parent)


TRUE = [
    line((0.0, 0.0, -15.0), (2.0, 1.0, -75.0), parent=-1),
    line((0.5, 0.2, -30.0), (30.0, 5.0, -55.0)),
    line((1.0, 0.5, -40.0), (-28.0, 14.0, -62.0)),
    line((1.2, 0.6, -45.0), (6.0, -27.0, -66.0)),
]


@pytest.fixture(scope="module")
def taken() -> tuple[ViewBank, tuple[Silhouette, ...]]:
    """Return pictures of the true roots from all sides."""
    return blank_of(SCENE).bank, pictured(TRUE)


def rendered(roots: list[Root]) -> np.ndarray:
    """Return the coverage by roots in all views."""
    count = np.cumsum([0, *(len(root.points_mm) for root in roots)])
    points, diameters = (np.concatenate(part) for part in zip(*((root.points_mm, root.diameters_mm) for root in roots), strict=True))
    tree = tubes.Tubes(points, diameters / 2.0, tuple(np.arange(*ends) for ends in itertools.pairwise(count)))
    return Rendering.draw(blank_of(SCENE), tree).coverage


def pictured(roots: list[Root]) -> tuple[Silhouette, ...]:
    return tuple(Silhouette(picture, np.ones(picture.shape, bool)) for picture in rendered(roots))


def told(roots, taken, **known):
    drawn = rendered([*roots, *known.get("nodules", ())])
    return {estimate.name: estimate for estimate in root_uncertainty.estimates(roots, *taken, drawn, known=Known(**known))}


def test_what_is_right_is_trusted_within_a_few_per_cent(taken) -> None:
    value = {"total_length_mm": length_mm(TRUE), "tips": 4.0, "mean_diameter_mm": 1.2}
    found = [told(TRUE, taken)[name] for name in value]
    low, high = np.array([one.interval for one in found]).T / list(value.values())
    assert low.max() < 1.0 < high.min()
    assert (high - low < [0.1, 0.51, 0.1]).all()  # twice the error that no picture shows; of tips 3 to 5
    assert all(one.trusted for one in found)


def test_a_storage_root_may_begin_one_radius_below_its_top(taken) -> None:
    """The top of a root of 14 mm may be round or cut: 7 mm of it are a tenth of the mean diameter of all roots."""
    laterals = [line((x, 0.0, -40.0), (2.0 * x, 0.0, -90.0), diameter_mm=0.8) for x in (-12.0, 12.0)]
    cut, below = ([line((0.0, 0.0, z), (0.0, 0.0, -75.0), diameter_mm=14.0, parent=-1), *laterals] for z in (-15.0, -22.0))
    low, high = told(cut, (taken[0], pictured(cut)))["mean_diameter_mm"].interval
    value, other = mean_diameter_mm(cut), mean_diameter_mm(below)
    assert low <= other < 0.95 * value
    assert value - low == pytest.approx(value - other, rel=0.25)
    assert high < 1.05 * value


def test_what_thick_roots_hide_may_be_more(taken) -> None:
    """A thin root behind a storage root is hidden in some views: the nearer it is, the more length may be hidden in all."""
    storage = line((0.0, 0.0, -15.0), (0.0, 0.0, -75.0), diameter_mm=14.0, parent=-1)
    near, far = ([storage, line((x, 0.0, -30.0), (x, 0.0, -60.0), diameter_mm=0.4)] for x in (7.5, 25.0))
    bank, _alike = taken
    pictures = {name: (bank, pictured(roots)) for name, roots in (("near", near), ("far", far))}
    close, away = told(near, pictures["near"])["total_length_mm"], told(far, pictures["far"])["total_length_mm"]
    assert close.interval[1] / close.value > away.interval[1] / away.value + 0.1
    assert close.interval[0] == pytest.approx(away.interval[0], rel=0.02)


def of_diameter(diameter_mm: float) -> list[Root]:
    return [line(root.points_mm[0], root.points_mm[-1], diameter_mm=diameter_mm, parent=root.parent) for root in TRUE]


def test_missing_surplus_and_thick_roots_lie_in_the_interval(taken) -> None:
    missing = told(TRUE[:3], taken)
    low, high = missing["total_length_mm"].interval
    assert low < length_mm(TRUE) < high
    assert missing["tips"].interval[1] > 4.0
    surplus = [*TRUE, line((0.0, 0.0, -20.0), (0.0, 30.0, -40.0))]
    low, high = told(surplus, taken)["total_length_mm"].interval
    assert low < length_mm(TRUE)
    assert high < 1.1 * length_mm(surplus)
    assert told([*TRUE, TRUE[1]], taken)["total_length_mm"].interval[0] < length_mm(TRUE), "a root found twice"
    low, high = told(of_diameter(1.3), taken)["mean_diameter_mm"].interval
    assert low < 1.2 < high


def test_a_lost_scan_and_roots_finer_than_pixels_are_not_trusted(taken) -> None:
    assert not any(estimate.trusted for estimate in told(TRUE, taken, lost=("roots moved",)).values())
    assert "half a pixel" in told(of_diameter(0.2), taken)["total_length_mm"].verdict
    assert root_uncertainty.estimates([], *taken, np.zeros((0, 0, 0))) == ()


def test_the_length_of_roots_that_are_not_resolved_may_be_larger(taken) -> None:
    """Twenty roots in a column of 3 mm: at 2 px/mm, no number of views separates those that share a pixel."""
    bank, pictures = taken
    places = np.random.default_rng(3).uniform(-1.5, 1.5, (20, 2, 2))
    bundle = [line((*top, -20.0), (*low, -70.0), diameter_mm=0.5, parent=-1) for top, low in places]
    found = told(bundle, (bank, pictured(bundle)))["total_length_mm"]
    projected = root_residual.Places.project(bundle, bank)
    assert root_uncertainty._merged_length(projected, pictures[0].coverage.shape, 1000, 1.0) > 0.25  # so many views do not help
    assert not found.trusted
    assert "may be merged" in found.verdict


@pytest.mark.parametrize(("diameter_mm", "lost"), [(0.5, False), (0.1, True)], ids=["a pixel wide", "a fifth of a pixel"])
def test_crowded_roots_below_half_a_pixel_may_have_more_volume(taken, diameter_mm: float, *, lost: bool) -> None:
    bank, pictures = taken
    places = np.random.default_rng(3).uniform(-1.0, 1.0, (20, 2, 2))
    bundle = [line((*top, -20.0), (*low, -70.0), diameter_mm=diameter_mm, parent=-1) for top, low in places]
    less, more = root_uncertainty.merged_volume(bundle, bank, pictures[0].coverage.shape, 1.0)
    assert less > 0.0  # six views
    assert root_uncertainty.merged_volume(bundle, bank, pictures[0].coverage.shape, 100.0)[0] > 10.0 > less  # no gaps between the roots
    assert (more > 0.2) == lost
    assert root_uncertainty.merged_volume([], bank, pictures[0].coverage.shape, 1.0) == (0.0, 0.0)


def test_flat_roots_and_the_net_pot_may_hide_length(taken) -> None:
    _bank, _pictures = taken
    hidden_mm = 8.0 * 0.02 * length_mm(TRUE)
    found = [told(TRUE, taken), told(TRUE, taken, flat=0.02), told(TRUE, taken, flat=0.04), told(TRUE, taken, hidden_mm=hidden_mm)]
    high = [one["total_length_mm"].interval[1] / length_mm(TRUE) for one in found]
    assert high[1] == pytest.approx(1.0 + 8.0 * 0.02, abs=0.02)
    assert high[3] == pytest.approx(high[1])
    assert high[0] < high[1] < high[2]
    assert "appear flat" in found[2]["total_length_mm"].verdict
    assert found[0]["mean_diameter_mm"] == found[3]["mean_diameter_mm"]
    assert found[0]["tips"] == found[2]["tips"]


def test_roots_may_continue_beyond_their_nodules(taken) -> None:
    bank, _ = taken
    nodules = [line((0.0, 0.0, z), (1.0, 0.0, z), diameter_mm=2.0, parent=-1) for z in (-30.0, -40.0)]
    found = told(TRUE, (bank, pictured([*TRUE, *nodules])), nodules=nodules)
    tips = sum(root.tip_seen for root in TRUE)
    assert found["tips"].interval[0] <= max(0, tips - len(nodules))
    assert "nodules" in found["tips"].verdict
