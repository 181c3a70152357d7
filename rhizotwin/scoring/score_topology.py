"""Comparison of the tree of a result with the true tree: identity of the roots, orders, branch points and ghosts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from rhizotwin.scenes.rsml import CentrePoints, Root, sample_centre_lines
from rhizotwin.scoring.score_roots import NEAR_MM, TIP_MM, count_matches

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

CLASSES_MM = (0.25, 0.5, 1.0, 2.0)
"""Limits of the classes of diameter, mm. They double from the width of about one pixel in pictures of 800x600."""
_STEP_MM = 0.25
"""Spacing of the sample points at which roots are compared, mm. It is half of `NEAR_MM`."""


@dataclass(frozen=True, kw_only=True)
class TopologyScore:
    """Agreement of the found tree with the true tree.

    A found and a true centre line lie on each other where they are closer than `NEAR_MM`, or than half of the true
    diameter. Main roots are the roots without a parent.
    """

    roots: int
    """Number of found roots."""
    roots_true: int
    """Number of true roots."""
    matched: float
    """Fraction of the true roots that are matched. A true root is matched if at least half of its length lies on a
    single found root."""
    parents: float
    """Fraction of the matched true roots with the correct parent. Roots whose true parent is not matched are
    excluded."""
    orders: float
    """Fraction of the matched true roots with the correct order."""
    order_length: float
    """Fraction of the true length on found centre lines where the nearest found root has the correct order."""
    identity: float
    """Fraction of found and true length that agrees if each true root is assigned to at most one found root and vice
    versa: 2 a / (found length + true length), where a is the true length on the assigned found roots (IDF1 of Ristani
    et al. 2016). Two roots that are exchanged at a crossing reduce it, although their length and orders are correct."""
    main_length: float
    """Fraction of the length of the true main roots that lies on found main roots, each assigned to at most one
    other."""
    branch_points: int
    """Number of found branch points."""
    branch_points_true: int
    """Number of true branch points."""
    branch_recall: float
    """Fraction of the true branch points that match a found one: within `TIP_MM`, on the same parent, one to one. It is
    1 if there are none."""
    branch_precision: float
    """Fraction of the found branch points that match a true one. It is 1 if there are none."""
    ghosts_mm: float
    """Found length that lies on no true centre line, mm."""
    missing_mm: float
    """True length that lies on no found centre line, mm."""
    doubled_mm: float
    """Found length on true centre lines, minus the true length on found ones, mm: parallel copies of roots, and zigzag.
    The error of the total length is ghosts + doubled - missing."""
    ghosts_by_diameter_mm: tuple[float, ...]
    """`ghosts_mm` by the found diameter, in the classes below, between and above `CLASSES_MM`."""
    missing_by_diameter_mm: tuple[float, ...]
    """`missing_mm` by the true diameter, in the same classes."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the names and values for a text table."""
        return [
            (
                "tree",
                f"identity {self.identity:.4f}, correct order {100.0 * self.order_length:.1f} % of the length, "
                f"main roots {100.0 * self.main_length:.1f} %",
            ),
            ("  roots", f"{self.roots}, true {self.roots_true}: {self.matched:.3f} matched, correct parent {self.parents:.3f}"),
            (
                "  branch points",
                f"{self.branch_points}, true {self.branch_points_true}: recall {self.branch_recall:.3f}, "
                f"precision {self.branch_precision:.3f}",
            ),
            ("  ghosts", f"{self.ghosts_mm:.1f} mm, doubled {self.doubled_mm:.1f} mm, missing {self.missing_mm:.1f} mm"),
            ("    by diameter", _by_class(self.ghosts_by_diameter_mm)),
            ("  missing by diameter", _by_class(self.missing_by_diameter_mm)),
        ]


def _by_class(lengths_mm: Sequence[float]) -> str:
    names = [f"up to {CLASSES_MM[0]:g}", *(f"to {limit:g}" for limit in CLASSES_MM[1:]), "thicker"]
    return ", ".join(f"{name}: {length:.1f}" for name, length in zip(names, lengths_mm, strict=True)) + " mm"


def compare_topology(found: Sequence[Root], true: Sequence[Root]) -> TopologyScore:
    """Compare the trees of two root systems, neither of which is empty."""
    on = _Overlap.of(sample_centre_lines(found, _STEP_MM), sample_centre_lines(true, _STEP_MM), len(found), len(true))
    length, true_length = float(on.found.length_mm.sum()), float(on.true.length_mm.sum())
    match = on.matches()
    known = [k for k, one in enumerate(match) if one >= 0]
    parents = [
        found[match[k]].parent == (match[true[k].parent] if true[k].parent >= 0 else -1)
        for k in known
        if true[k].parent < 0 or match[true[k].parent] >= 0
    ]
    orders = [found[match[k]].order == true[k].order for k in known]
    order_found, order_true = (np.array([root.order for root in roots]) for roots in (found, true))
    right = order_found[on.found.root[on.nearest]] == order_true[on.true.root]
    mains, true_mains = ([k for k, root in enumerate(roots) if root.parent < 0] for roots in (found, true))
    main_true_mm = on.true.length_mm[np.isin(on.true.root, true_mains)].sum()
    points, true_points, branches = _match_branch_points(found, true, on)
    covered_mm = float(on.true.length_mm[on.true_near].sum())
    near_mm = float(on.found.length_mm[on.found_near].sum())
    return TopologyScore(
        roots=len(found),
        roots_true=len(true),
        matched=len(known) / len(true),
        parents=float(np.mean(parents)) if parents else 0.0,
        orders=float(np.mean(orders)) if orders else 0.0,
        order_length=float(on.true.length_mm[on.true_near & right].sum()) / covered_mm if covered_mm else 0.0,
        identity=2.0 * _assign(on.length_mm) / (length + true_length),
        main_length=_assign(on.length_mm[np.ix_(true_mains, mains)]) / float(main_true_mm),
        branch_points=points,
        branch_points_true=true_points,
        branch_recall=branches / true_points if true_points else 1.0,
        branch_precision=branches / points if points else 1.0,
        ghosts_mm=length - near_mm,
        missing_mm=true_length - covered_mm,
        doubled_mm=near_mm - covered_mm,
        ghosts_by_diameter_mm=_classify(on.found, ~on.found_near),
        missing_by_diameter_mm=_classify(on.true, ~on.true_near),
    )


@dataclass(frozen=True)
class _Overlap:
    """Which sample points of two root systems lie on each other."""

    found: CentrePoints
    """Sample points (F,) of the found roots."""
    true: CentrePoints
    """Sample points (T,) of the true roots."""
    nearest: Indices
    """Index (T,) of the found point that is nearest to each true point."""
    found_near: NDArray[np.bool_]
    """Whether each found point lies on a true centre line (F,)."""
    true_near: NDArray[np.bool_]
    """Whether each true point lies on a found centre line (T,)."""
    length_mm: Floats
    """Length of each true root that lies on each found root, mm, (true roots, found roots)."""

    @staticmethod
    def of(found: CentrePoints, true: CentrePoints, found_roots: int, true_roots: int) -> "_Overlap":
        tree = cKDTree(found.points_mm)
        beside = tree.query_ball_point(true.points_mm, np.maximum(NEAR_MM, true.radius_mm), return_sorted=False)
        of_true = np.repeat(np.arange(len(beside)), [len(some) for some in beside])
        of_found = np.concatenate([np.asarray(some, np.int64) for some in beside])
        # each true point counts once for each found root, however many of that root's points are near
        pairs = np.unique(np.stack([of_true, found.root[of_found]], axis=1), axis=0)
        length = np.zeros((true_roots, found_roots))
        np.add.at(length, (true.root[pairs[:, 0]], pairs[:, 1]), true.length_mm[pairs[:, 0]])
        found_near, true_near = np.zeros(len(found.points_mm), np.bool_), np.zeros(len(true.points_mm), np.bool_)
        found_near[of_found] = True
        true_near[of_true] = True
        nearest = np.asarray(tree.query(true.points_mm)[1], np.int64)
        return _Overlap(found, true, nearest, found_near, true_near, length)

    def matches(self) -> list[int]:
        """Return for each true root the found root that covers at least half of its length; -1 if there is none."""
        true_mm = np.bincount(self.true.root, weights=self.true.length_mm)
        return [int(row.argmax()) if row.max() >= 0.5 * length else -1 for row, length in zip(self.length_mm, true_mm, strict=True)]


def _assign(length_mm: Floats) -> float:
    """Return the largest total overlap, mm, if each row (true root) is assigned to at most one column (found root)."""
    return float(length_mm[linear_sum_assignment(length_mm, maximize=True)].sum())


def _match_branch_points(found: Sequence[Root], true: Sequence[Root], on: _Overlap) -> tuple[int, int, int]:
    """Return the numbers of found, of true and of matching branch points."""
    on_true = on.length_mm.argmax(axis=0)
    places, true_places = _branch_points(found), _branch_points(true)
    if not len(places) or not len(true_places):
        return len(places), len(true_places), 0
    parents = on_true[[root.parent for root in found if root.parent >= 0]]
    same = np.array([root.parent for root in true if root.parent >= 0])[:, None] == parents
    return len(places), len(true_places), count_matches(same & (cdist(true_places, places) <= TIP_MM))


def _branch_points(roots: Sequence[Root]) -> Floats:
    """Return the points (B, 3), mm, on the centre lines of parents that are nearest to the starts of their laterals."""
    found = []
    for root in roots:
        if root.parent >= 0:
            on_parent = sample_centre_lines([roots[root.parent]], _STEP_MM).points_mm
            found.append(on_parent[np.linalg.norm(on_parent - root.points_mm[0], axis=1).argmin()])
    return np.array(found).reshape(-1, 3)


def _classify(points: CentrePoints, chosen: NDArray[np.bool_]) -> tuple[float, ...]:
    """Return the length, mm, of the chosen (P,) sample points by class of diameter."""
    of = np.searchsorted(CLASSES_MM, 2.0 * points.radius_mm[chosen])
    return tuple(np.bincount(of, weights=points.length_mm[chosen], minlength=len(CLASSES_MM) + 1).tolist())
