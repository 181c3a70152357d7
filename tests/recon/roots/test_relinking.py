"""True root systems, cut and swapped where roots touch as tracing does, come back from linking."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from rhizotwin.recon.roots import linking
from rhizotwin.recon.tubes import tubes
from rhizotwin.recon.tubes.tubes import Index, Tubes
from rhizotwin.scenes.files import load_scene
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.sim import growth

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
    return tubes.string([root.points_mm for root in roots], [root.diameters_mm / 2.0 for root in roots])


@dataclass(frozen=True)
class Right:
    """How much of a plant is as it grew: shares of all nodes."""

    root: float
    """Nodes in the branch that holds most of their root, each root's branch its own."""
    parent: float
    """Nodes for which also the branch hangs on that of the true parent."""


def right(found: Tubes, kept: np.ndarray, true: Tubes) -> Right:
    """Compare a tree of some of the true nodes (N,) with the true one."""
    of, found_of = true.owner, np.full(len(true.centre_mm), -1)
    found_of[kept] = found.owner
    together = np.zeros((len(true.branches), len(found.branches)), np.int64)
    np.add.at(together, (of[kept], found_of[kept]), 1)
    roots, lines = linear_sum_assignment(-together)
    branch = dict(zip(roots.tolist(), lines.tolist(), strict=True))
    hung = {k: found.owner[found.branches[line][0]] for k, line in branch.items()}
    rightly = np.array([k == 0 or branch.get(int(of[true.branches[k][0]])) == hung[k] for k in branch])
    held = together[roots, lines]
    return Right(float(held.sum() / len(of)), float(held[rightly].sum() / len(of)))


def hanging(true: Tubes, branches: list[Index]) -> Tubes | None:
    """Return the tree of the same nodes with other branches; None where some hang on themselves."""
    order = tubes.hanging_order(branches, len(true.centre_mm))
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


def turned(true: Tubes) -> tuple[Tubes, int]:
    """Return the tree with the roots turned round whose tips touch another, as if traced from there, and how many."""
    of, near = true.owner, cKDTree(true.centre_mm)
    bearing = {int(of[nodes[0]]) for nodes in true.branches[1:]}
    tree, done = true, 0
    for k, line in enumerate(true.branches):
        touching = [node for node in sorted(near.query_ball_point(true.centre_mm[line[-1]], TOUCH_MM)) if of[node] not in (k, of[line[0]])]
        if k == 0 or k in bearing or len(line) <= APART_NODES or not touching:
            continue
        tried = [np.concatenate([touching[:1], line[:0:-1]]) if np.array_equal(nodes, line) else nodes for nodes in tree.branches]
        if (damaged := hanging(true, tried)) is not None:
            tree, done = damaged, done + 1
    return tree, done


PLANTS = ("radish_day10a", "radish_day15c", "bean", "maize")


@pytest.mark.parametrize("name", PLANTS)
def test_a_plant_as_it_grew_stays_as_it_is_and_a_damaged_one_is_mended(name: str):
    """What stays wrong of a cut are the few nodes about it that lie as well on the other's course."""
    true = grown(name)
    for (damaged, places), least, before, after in (((true, 1), 1, 1.0, 0.999), (cut(true), 5, 0.9, 0.99), (turned(true), 1, 0.995, 0.998)):
        assert places >= least
        assert right(damaged, np.ones(len(true.centre_mm), bool), true).parent <= before
        found = right(*linking.link(damaged), true)
        assert min(found.root, found.parent) > after
