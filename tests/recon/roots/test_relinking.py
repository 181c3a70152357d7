"""True root systems, cut and swapped where roots touch as tracing does, come back from linking."""

from dataclasses import dataclass

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


def cut(true: Tubes, seed: int, *, swapped: bool = False) -> tuple[Tubes, int]:
    """Return the tree with damage where roots touch, and in how many places.

    What is left of a root hangs on the one that it touches or, ``swapped``, both go on in each other.
    """
    draw, of = np.random.default_rng(seed), true.owner
    pairs = cKDTree(true.centre_mm).query_pairs(TOUCH_MM, output_type="ndarray")
    tree, free, done = true, np.ones(len(of), bool), 0
    for here, there in draw.permutation(pairs[of[pairs[:, 0]] != of[pairs[:, 1]]]):
        a, b = tree.owner[[here, there]]
        first, second = tree.branches[a], tree.branches[b]
        i, j = int(np.flatnonzero(first == here)[-1]), int(np.flatnonzero(second == there)[-1])
        around = [line[max(at - APART_NODES, 0) : at + APART_NODES] for line, at in ((first, i), (second, j))]
        if a == b or min(i, j) <= APART_NODES or i + APART_NODES >= len(first) or j + APART_NODES >= len(second):
            continue
        if not free[np.concatenate(around)].all():
            continue
        tried = list(tree.branches)
        tried[a] = np.concatenate([first[:i], second[j:]]) if swapped else first[:i]
        if swapped:
            tried[b] = np.concatenate([second[:j], first[i:]])
        else:
            tried.append(np.concatenate([[there], first[i:]]))
        if (damaged := hanging(true, tried)) is not None:
            tree, done = damaged, done + 1
            free[np.concatenate(around)] = False
    return tree, done


def turned(true: Tubes) -> tuple[Tubes, int]:
    """Return the tree with the roots turned round whose tips touch another, as if traced from there, and how many."""
    of, near = true.owner, cKDTree(true.centre_mm)
    bearing = {int(of[nodes[0]]) for nodes in true.branches[1:]}
    tree, done = true, 0
    for k, line in enumerate(true.branches):
        if k == 0 or k in bearing or len(line) <= APART_NODES:
            continue
        at = next(
            (node for node in sorted(near.query_ball_point(true.centre_mm[line[-1]], TOUCH_MM)) if of[node] not in (k, of[line[0]])), -1
        )
        tried = [np.concatenate([[at], line[:0:-1]]) if np.array_equal(nodes, line) else nodes for nodes in tree.branches]
        if at >= 0 and (damaged := hanging(true, tried)) is not None:
            tree, done = damaged, done + 1
    return tree, done


PLANTS = ("radish_day10a", "radish_day15c", "bean", "maize")


@pytest.mark.parametrize("name", PLANTS)
def test_a_plant_as_it_grew_stays_as_it_is(name: str):
    true = grown(name)
    linked, kept = linking.link(true)
    assert right(linked, kept, true).root > 0.999
    assert right(linked, kept, true).parent > 0.999


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", PLANTS)
def test_roots_that_were_cut_where_they_touch_others_are_whole_again(name: str, seed: int):
    true = grown(name)
    damaged, places = cut(true, seed)
    assert places >= 5
    assert right(damaged, np.ones(len(true.centre_mm), bool), true).parent < 0.9
    linked, kept = linking.link(damaged)
    # what stays wrong are the few nodes about a cut that lie as well on the other's course
    assert right(linked, kept, true).root > 0.99
    assert right(linked, kept, true).parent > 0.99


@pytest.mark.parametrize("name", PLANTS)
def test_roots_that_were_traced_from_their_tips_are_turned_round(name: str):
    true = grown(name)
    damaged, places = turned(true)
    assert places
    before = right(damaged, np.ones(len(true.centre_mm), bool), true).parent
    linked, kept = linking.link(damaged)
    assert before < 0.995
    assert right(linked, kept, true).parent > 0.998


@pytest.mark.xfail(reason="a link begins at an end, and two roots that go on in each other have none there", strict=True)
@pytest.mark.parametrize("name", PLANTS)
def test_roots_that_go_on_in_each_other_where_they_touch_are_parted(name: str):
    true = grown(name)
    damaged, _ = cut(true, 1, swapped=True)
    linked, kept = linking.link(damaged)
    assert right(linked, kept, true).root > 0.99
