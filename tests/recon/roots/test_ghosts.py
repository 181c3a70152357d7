"""What is told from roots: tubes that explain nothing, that lie in others, and ends that are none."""

import numpy as np

from rhizotwin.recon.roots import ghosts, proof
from rhizotwin.recon.tubes import tube_picture, tube_profiles, tubes
from tests.recon.lines import line
from tests.recon.strings import TRUNK, TWIG, pictured, strung


def test_proof_tells_a_root_from_a_ghost():
    true = strung(TRUNK, TWIG, radius_mm=0.2)
    seen = pictured(strung(TRUNK, radius_mm=0.2))
    at = seen.project(true.centre_mm)
    depth = tube_picture.optical_depth(seen, true, at, 0.0)
    weighed = proof.weigh(seen, true, at, depth, tube_picture.unexplained(seen, depth), 0.0)
    share = weighed.explained / (np.abs(weighed.explained) + weighed.left)
    root, ghost = true.branches[0][3:-3], true.branches[1][4:-2]
    assert np.median(share[root]) > 0.9
    assert (share[ghost] < 0.0).all()


def _judged(system: tubes.Tubes, worse: dict[int, tuple[float, float]]) -> np.ndarray:
    """Judge ends that are half hidden and leave a fiftieth, but for some branches: what shows of them, and the share they leave."""
    visible, left = np.full(len(system.radius_mm), 0.5), np.full(len(system.radius_mm), 0.02)
    for k, (shown, share) in worse.items():
        visible[system.own(k)], left[system.own(k)] = shown, share
    none = np.zeros(len(system.radius_mm), bool)
    return ghosts.uncertain_ends(system, visible, proof.Proof(1.0 - left, left, left), none)


def _laterals() -> list[np.ndarray]:
    angle = np.arange(6) * 2.0 * np.pi / 6.0
    return [line((0.0, 0.0, -24.0 - 4.0 * k), (4.0 * np.cos(a), 4.0 * np.sin(a), -27.0 - 4.0 * k)) for k, a in enumerate(angle)]


def test_an_end_is_uncertain_where_little_shows_much_is_left_and_another_root_is_near():
    beside = line((0.0, 0.0, -44.0), (0.4, 0.0, -46.0))  # its tip is 0.2 mm from the trunk's surface, those of the others far
    system = strung(TRUNK, *_laterals(), beside)
    near = len(system.branches) - 1
    np.testing.assert_array_equal(_judged(system, {near: (0.05, 0.3)}), system.owner == near)
    for good in ({}, {near: (0.5, 0.3)}, {near: (0.25, 0.02)}):
        assert not _judged(system, good).any()
    assert not _judged(system, {3: (0.05, 0.02)}).any()  # hidden, but it stands free of all others and leaves no more than they do
    np.testing.assert_array_equal(_judged(system, {3: (0.05, 0.9)}), system.owner == 3)


def test_only_what_goes_on_beyond_the_last_lateral_is_uncertain_and_long_ends_are_not():
    laterals = _laterals()
    twig = line(tuple(laterals[2][20]), tuple(laterals[2][20] + np.array([0.0, 0.0, -3.0])))
    system = strung(TRUNK, *laterals, twig, line((0.0, 0.0, -47.0), (12.0, 0.0, -47.0)))
    bearer, branch = 3, system.branches[3]
    after = branch[np.flatnonzero(branch == system.branches[7][0])[0] + 1 :]
    gone = _judged(system, {bearer: (0.0, 0.9), 8: (0.0, 0.9)})
    assert 0 < len(after) < len(branch) - 2
    np.testing.assert_array_equal(np.flatnonzero(gone), after)


def test_what_stands_out_by_less_than_its_diameter_is_a_bulge_and_has_no_tip():
    """On thick organs too; as long a lateral that is thinner has a tip, and so has the end of a root beyond its last lateral."""
    bulge, twig = line((0.0, 0.0, -30.0), (0.8, 0.0, -30.0)), line((0.0, 0.0, -40.0), (0.8, 0.0, -40.0))
    system = strung(TRUNK, bulge, twig, line((0.0, 0.0, -49.7), (8.0, 0.0, -49.7)))
    radius = np.select([system.owner == 1, system.owner == 2], [0.35, 0.15], 0.3)
    system = tubes.moved(system, system.centre_mm, radius)
    good, everything = np.full(len(radius), 0.5), np.ones(len(radius), bool)
    for organ in (everything, ~everything):
        judged = ghosts.uncertain_ends(system, good, proof.Proof(good, 0.02 * good, good), organ)
        np.testing.assert_array_equal(judged, system.owner == 1)


def test_a_root_in_a_crowd_stays_though_hardly_any_of_it_shows():
    around = [line((x, y, -20.0), (x, y, -50.0)) for x, y in ((0.8, 0.0), (-0.8, 0.0), (0.4, 0.7), (-0.4, 0.7), (0.4, -0.7), (-0.4, -0.7))]
    crowd = strung(*around, TRUNK, radius_mm=0.35)
    seen, none = pictured(crowd), np.zeros(len(crowd.radius_mm), bool)
    at = seen.project(crowd.centre_mm)
    depth = tube_picture.optical_depth(seen, crowd, at, 0.0)
    left = tube_picture.unexplained(seen, depth)
    inner = crowd.branches[-1][3:-3]
    assert np.median(tube_profiles.profiles(seen, crowd, at, depth, left, 0.0).residual_gradient().visible[inner]) < 0.15
    assert not ghosts.unexplaining(crowd, proof.weigh(seen, crowd, at, depth, left, 0.0), none)[inner].any()


def test_what_stands_in_the_corners_of_the_cut_top_is_the_tops():
    """The first branch begins at the rim of sight: what is found beside its flat end is its own, a lateral just below it is not."""
    taproot = line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0))
    system = strung(taproot, line((0.0, 0.0, -20.0), (0.8, 0.3, -19.8)), line((0.0, 0.0, -20.6), (6.0, 0.0, -24.0)), radius_mm=0.75)
    none = np.zeros(len(system.radius_mm), bool)
    kept = system.keep(system.staying(ghosts.inside_another(system, none, 0.25)))
    assert len(kept.branches) == 2
    np.testing.assert_allclose(kept.centre_mm[kept.branches[1][-1]], [6.0, 0.0, -24.0])
    assert len(system.keep(system.staying(ghosts.inside_another(system, none, 0.0))).branches) == 3


def test_a_second_tube_of_a_root_is_dispensable_and_a_root_beside_it_is_not():
    def hanging(x: float) -> np.ndarray:
        return np.concatenate([line((0.0, 0.0, -26.0), (x, 0.0, -28.0)), line((x, 0.0, -28.0), (x, 0.0, -48.0))[1:]])

    truth = strung(TRUNK, hanging(0.7), radius_mm=0.3)
    seen, found = pictured(truth), strung(TRUNK, hanging(0.7), hanging(0.1), radius_mm=0.3)
    found = tubes.moved(found, found.centre_mm, np.where(found.owner == 2, 0.1, 0.3))
    none = np.zeros(len(found.radius_mm), bool)

    def unexplained(drawn: tubes.Tubes) -> np.ndarray:
        depth = tube_picture.optical_depth(seen, drawn, seen.project(drawn.centre_mm), 0.0)
        return np.nansum(tube_profiles.misfit(seen, found, tube_picture.unexplained(seen, depth)), axis=0)

    at = seen.project(found.centre_mm)
    depth = tube_picture.optical_depth(seen, found, at, 0.0)
    proved = proof.weigh(seen, found, at, depth, tube_picture.unexplained(seen, depth), 0.0)
    np.testing.assert_array_equal(ghosts.unproven(found, proved, none), found.owner == 2)
    without = found.owner > 0
    more = unexplained(found.keep(found.staying(without))) - unexplained(found)
    np.testing.assert_array_equal(np.unique(found.owner[ghosts.dispensable(found, without & (found.owner == 1), more, proved.alone)]), [])
    more = unexplained(found.keep(found.staying(found.owner == 2))) - unexplained(found)
    np.testing.assert_array_equal(ghosts.dispensable(found, found.owner == 2, more, proved.alone), found.owner == 2)
