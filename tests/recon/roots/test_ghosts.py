"""What is told from roots: tubes that lie in others, and ends that are none."""

import numpy as np

from rhizotwin.recon.coverage.evidence import Evidence, Nodes
from rhizotwin.recon.device import Float
from rhizotwin.recon.roots import ghosts, proof
from rhizotwin.recon.tubes import tube_picture, tube_profiles, tubes
from tests.recon.strings import TRUNK, line, pictured, strung


def compared(seen: Evidence, drawn: tubes.Tubes) -> tuple[Nodes, Float, Float]:
    """Return where the nodes of tubes are seen, their optical depth, and what it leaves unexplained."""
    at = seen.project(drawn.centre_mm)
    depth = tube_picture.optical_depth(seen, drawn, at, 0.0)
    return at, depth, tube_picture.unexplained(seen, depth)


def test_an_end_is_uncertain_where_little_shows_much_is_left_and_another_root_is_near():
    angle = np.arange(6) * 2.0 * np.pi / 6.0
    laterals = [line((0.0, 0.0, -24.0 - 4.0 * k), (4.0 * np.cos(a), 4.0 * np.sin(a), -27.0 - 4.0 * k)) for k, a in enumerate(angle)]
    beside = line((0.0, 0.0, -44.0), (0.4, 0.0, -46.0))  # its tip is 0.2 mm from the trunk's surface, those of the others far
    system, near = strung(TRUNK, *laterals, beside), 7
    for branch, shown, share, expected in (
        (near, 0.05, 0.3, True),
        (near, 0.5, 0.3, False),  # it shows
        (near, 0.25, 0.02, False),  # it leaves little
        (3, 0.05, 0.02, False),  # hidden, but it stands free of all others and leaves no more than they do
        (3, 0.05, 0.9, True),
    ):
        own = system.owner == branch
        visible, left = np.where(own, shown, 0.5), np.where(own, share, 0.02)
        judged = ghosts.uncertain_ends(system, visible, proof.Proof(1.0 - left, left, left), np.zeros(len(own), bool))
        np.testing.assert_array_equal(judged, own & expected)


def test_a_second_tube_of_a_root_is_dispensable_and_a_root_beside_it_is_not():
    def hanging(x: float) -> np.ndarray:
        return line((0.0, 0.0, -26.0), (x, 0.0, -28.0), (x, 0.0, -48.0))

    seen, found = pictured(strung(TRUNK, hanging(0.7), radius_mm=0.3)), strung(TRUNK, hanging(0.7), hanging(0.1), radius_mm=0.3)
    found = tubes.moved(found, found.centre_mm, np.where(found.owner == 2, 0.1, 0.3))
    proved = proof.weigh(seen, found, *compared(seen, found), 0.0)
    np.testing.assert_array_equal(ghosts.unproven(found, proved, np.zeros(len(found.radius_mm), bool)), found.owner == 2)

    def unexplained(drawn: tubes.Tubes) -> np.ndarray:
        return np.nansum(tube_profiles.misfit(seen, found, compared(seen, drawn)[2]), axis=0)

    for without, judged, expected in ((found.owner > 0, found.owner == 1, ()), (found.owner == 2, found.owner == 2, (2,))):
        more = unexplained(found.keep(found.staying(without))) - unexplained(found)
        np.testing.assert_array_equal(ghosts.dispensable(found, judged, more, proved), np.isin(found.owner, expected))
