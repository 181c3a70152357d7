"""True root systems, cut and swapped where roots touch as tracing does, come back from linking."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from rhizotwin.recon.roots import linking
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.branch_graph import Index, parents_first
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes.files import load_scene
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.sim import growth
from tests.recon.strings import line

TOUCH_MM = 1.0
"""Tracing takes roots whose centre lines come this near for one: some two cells of its search space."""
APART_NODES = 8
"""Nodes between a damage and the ends of its roots, and the next damage: 5 mm."""


@cache
def grown(name: str) -> Tubes:
    """Return a plant of the library as tubes, branch by root."""
    scene = load_scene(name)
    assert isinstance(scene.specimen, GrownSpecimen)
    roots = growth.grow(scene.specimen, canister=scene.canister, net_pot=scene.net_pot)
    return tubes.place_nodes([root.points_mm for root in roots], [root.diameters_mm / 2.0 for root in roots])


def right(found: Tubes, kept: np.ndarray, true: Tubes) -> float:
    """Return the share of true nodes (N,) whose root's own branch holds them, and hangs on that of the true parent."""
    of, found_of = true.owner, np.full(len(true.centre_mm), -1)
    found_of[kept] = found.owner
    together = np.zeros((len(true.branches), len(found.branches)), np.int64)
    np.add.at(together, (of[kept], found_of[kept]), 1)
    roots, lines = linear_sum_assignment(-together)
    branch = dict(zip(roots.tolist(), lines.tolist(), strict=True))
    hung = {k: found.owner[found.branches[line][0]] for k, line in branch.items()}
    rightly = np.array([k == 0 or branch.get(int(of[true.branches[k][0]])) == hung[k] for k in branch])
    return float(together[roots, lines][rightly].sum() / len(of))


def hanging(true: Tubes, branches: list[Index]) -> Tubes | None:
    """Return the tree of the same nodes with other branches; None where some hang on themselves."""
    order = parents_first(branches, len(true.centre_mm))
    return Tubes(true.centre_mm, true.radius_mm, tuple(branches[k] for k in order)) if len(order) == len(branches) else None


def cut(true: Tubes) -> tuple[Tubes, int]:
    """Return the tree with roots cut where they touch, and in how many places: the rest hangs on the one that it touches."""
    draw, of = np.random.default_rng(1), true.owner
    pairs = cKDTree(true.centre_mm).query_pairs(TOUCH_MM, output_type="ndarray")
    tree, free, done = true, np.ones(len(of), bool), 0
    for here, there in draw.permutation(pairs[of[pairs[:, 0]] != of[pairs[:, 1]]]):
        a, b = tree.owner[[here, there]]
        first, second = tree.branches[a], tree.branches[b]
        i, j = int(np.flatnonzero(first == here)[-1]), int(np.flatnonzero(second == there)[-1])
        if a == b or any(at <= APART_NODES or at + APART_NODES >= len(nodes) for nodes, at in ((first, i), (second, j))):
            continue
        around = np.concatenate([first[i - APART_NODES : i + APART_NODES], second[j - APART_NODES : j + APART_NODES]])
        tried = [*tree.branches, np.concatenate([[there], first[i:]])]
        tried[a] = first[:i]
        if free[around].all() and (damaged := hanging(true, tried)) is not None:
            tree, done = damaged, done + 1
            free[around] = False
    return tree, done


@pytest.mark.parametrize("name", ["radish_day15c", "bean"])
@pytest.mark.parametrize(
    ("damage", "least", "before", "after"),
    [(lambda true: (true, 1), 1, 1.0, 0.999), (cut, 5, 0.9, 0.99)],
    ids=["as it grew", "cut"],
)
def test_a_damaged_plant_is_mended(name: str, damage, least: int, before: float, after: float):
    """What stays wrong of a cut are the few nodes about it that lie as well on the other's course."""
    true = grown(name)
    damaged, places = damage(true)
    assert places >= least
    assert right(damaged, np.ones(len(true.centre_mm), bool), true) <= before
    assert right(*linking.link(damaged), true) > after


def test_nothing_is_hung_on_itself() -> None:
    """A lateral comes round to its parent's tip head to head: were it the one to go on, nothing would hold either of them."""
    trunk, parent = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=0.5), line((0.5, 0.0, -10.0), (14.0, 0.0, -10.0), step=0.5)
    round_it = (5.0, 0.4, -10.5), (5.0, 0.4, -16.0), (20.0, 0.4, -16.0), (20.0, 0.1, -10.0), (14.5, 0.0, -10.0)
    centre = np.concatenate([trunk, parent, line(*round_it, step=0.5)])
    own = np.split(np.arange(len(centre)), [len(trunk), len(trunk) + len(parent)])
    branches = own[0], np.concatenate([[20], own[1]]), np.concatenate([own[1][8:9], own[2]])
    linked, kept = linking.link(Tubes(centre, np.full(len(centre), 0.1), branches))
    assert kept.all()
    assert len(linked.branches) == 2


def test_a_root_reached_along_its_lateral_leaves_its_upper_part() -> None:
    """A thin lateral touches the neighbour of its root: tracing took it for the way from the neighbour to the root's lower part."""
    step, fork, touch = tubes.SPACING_MM, (6.0, 0.0, -12.0), (6.0, 3.0, -14.0)
    trunk, neighbour = line((0.0, 0.0, 0.0), (0.0, 0.0, -30.0), step=step), line((0.0, 0.0, -5.0), touch, (10.0, 12.0, -22.0), step=step)
    upper, lower = line((0.0, 0.0, -4.0), fork, step=step), line(fork, (15.0, 0.0, -24.0), step=step)[1:]
    lateral = line(fork, touch, (6.0, 14.0, -21.0), step=step)[1:]
    back = lateral[np.linalg.norm(lateral - touch, axis=1).argmin() :: -1] + 0.1
    centre = np.concatenate([trunk, neighbour, upper, lateral, back, lower])
    radius = np.repeat([0.5, 0.5, 0.5, 0.2, 0.2, 0.5], [len(part) for part in (trunk, neighbour, upper, lateral, back, lower)])
    own = np.split(np.arange(len(radius)), np.cumsum([len(trunk), len(neighbour), len(upper) + len(lateral)]))
    bases = cKDTree(trunk).query([neighbour[0], upper[0]])[1].tolist(), own[1][cKDTree(neighbour).query(touch)[1]]
    branches = own[0], *(np.concatenate([[base], nodes]) for base, nodes in zip((*bases[0], bases[1]), own[1:], strict=True))
    linked, kept = linking.link(Tubes(centre, radius, branches))
    np.testing.assert_array_equal(np.flatnonzero(~kept), own[3][: len(back)], "the second path along the lateral is gone")
    base = [linked.centre_mm[nodes[0]] for nodes in linked.branches if np.allclose(linked.centre_mm[nodes[-1]], lower[-1])]
    assert np.linalg.norm(np.subtract(base, fork), axis=1).tolist() == pytest.approx([0.0], abs=2.0 * step)
