"""Assembly of the error budget of a volume, and of the checks of its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.carved_hull import CarvedHull, missed_share
from rhizotwin.recon.hull.leaves import Leaves
from rhizotwin.recon.hull.trimming import TrimmedHull
from rhizotwin.recon.optics import projection
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.uncertainty import (
    bare_uncertainty,
    canister_uncertainty,
    hidden_top,
    occlusion,
    overlap,
    root_uncertainty,
    scattered_light,
    shape_checks,
    solid_uncertainty,
    tube_uncertainty,
    wall_contact,
)
from rhizotwin.recon.uncertainty.budget import Budget, Term
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration, find_calibration
from rhizotwin.recon.uncertainty.checks import Check
from rhizotwin.recon.uncertainty.hidden_top import HiddenTop
from rhizotwin.recon.uncertainty.posterior import Posterior
from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import Root


@dataclass(frozen=True, kw_only=True)
class UnitedShape:
    """Shape of solids and tubes whose volume is assessed."""

    leaves: Leaves
    """Leaves of the whole shape."""
    thick: Leaves
    """Leaves of thick roots and solids."""
    solids: TrimmedHull
    """Trimmed hull of the solids, and the parts of the hull that complete thick roots."""
    part: Leaves
    """Leaves of the hull around them, before trimming."""
    posterior: Posterior | None = None
    """Fitted roots; None if there are none."""

    @property
    def roots(self) -> tuple[Root, ...]:
        """The fitted roots as centre lines; empty if there are none."""
        return () if self.posterior is None else self.posterior.roots

    @property
    def system(self) -> RootSystem | None:
        """Fitted roots; None if there are none."""
        return None if self.posterior is None else self.posterior.system


@dataclass(frozen=True, kw_only=True)
class AssessedVolume:
    """Error budget of a volume, with the checks of the shape."""

    budget: Budget
    checks: tuple[Check, ...]
    """Checks of the motion of the roots, and of the agreement between silhouettes and shape."""
    hidden: HiddenTop | None
    """Parts of taproots that the net pot hides; None if there are none."""


def assess_volume(carved: CarvedHull, shape: UnitedShape, settings: Settings, *, scattered: float | None) -> AssessedVolume:
    """Assemble the error budget of a shape, and check the shape against the pictures.

    Parameters
    ----------
    carved : CarvedHull
        Carved hull with its views and silhouettes.
    shape : UnitedShape
        The shape.
    settings : Settings
        Slack of the outlines, extrapolation of taproots, and limits of trust.
    scattered : float or None
        Fraction of light that is scattered around roots; None if it is unknown.
    """
    system, missed, volume_mm3 = shape.system, missed_share(carved), shape.leaves.volume_mm3()
    tubes = None if shape.posterior is None else tube_uncertainty.estimate(shape.posterior)
    terms = (
        *(() if tubes is None else tubes.terms),
        *_solid_terms(carved, shape, settings, missed),
        _merged_term(carved, shape.roots, volume_mm3),
        *(() if scattered is None else (scattered_light.scattered_term(scattered, max(volume_mm3 - shape.thick.volume_mm3(), 0.0)),)),
    )
    budget = Budget(volume_mm3=volume_mm3, terms=terms, views=carved.bank.count, trust=settings.trust)
    hidden = _hidden_top(carved, shape.roots, shape.leaves)
    if hidden is not None:
        budget = _add_hidden_top(budget, hidden, extrapolate=settings.hull.extrapolate_taproot)
    budget = replace(budget, calibration=_calibration(carved, shape, budget, missed))
    moved = None if system is None else system.cameras.roots
    sway_mm = None if system is None or moved is None else moved.after_px / system.px_a_mm
    fill, unexplained = (0.0, 0.0) if tubes is None else (tubes.fill, tubes.unexplained)
    checks = (
        shape_checks.check_motion(sway_mm, settings.trust),
        shape_checks.check_agreement(missed=missed, unexplained=unexplained, fill=fill, trust=settings.trust),
    )
    return AssessedVolume(budget=budget, checks=checks, hidden=hidden)


def _solid_terms(carved: CarvedHull, shape: UnitedShape, settings: Settings, missed: float) -> tuple[Term, ...]:
    """Return the terms of solids, hidden parts, wall, water, cameras and canister."""
    volume_mm3, slack_px = shape.leaves.volume_mm3(), settings.hull.slack_px
    half = solid_uncertainty.half_excess(carved.bank, carved.cameras.order, carved.maps, carved.hull, shape.solids, carved.water)
    edges = None if carved.cameras.markers is None else carved.cameras.markers.canister
    return (
        *solid_uncertainty.estimate_terms(
            carved.bank,
            carved.hull,
            shape.part,
            shape.solids,
            slack_px=slack_px,
            half_excess=half,
            missed=missed,
            binary=carved.is_binary,
        ),
        *(() if shape.system is None else (overlap.overlap_term(shape.system, shape.part, shape.solids.leaves),)),
        occlusion.occlusion_term(carved.bank, carved.maps, shape.leaves, shape.solids.leaves, shape.roots, carved.water),
        wall_contact.wall_contact(shape.thick, carved.water),
        solid_uncertainty.water_term(volume_mm3),
        *bare_uncertainty.camera_terms(
            carved.cameras.bare,
            shape.leaves,
            views=carved.bank.count,
            mm3_per_px=solid_uncertainty.mm3_per_px(carved.hull, slack_px=slack_px),
        ),
        canister_uncertainty.canister_term(carved.cameras.views, carved.bank.optics, shape.leaves, volume_mm3, edges=edges),
    )


def _merged_term(carved: CarvedHull, roots: Sequence[Root], volume_mm3: float) -> Term:
    """Return the term of roots that may be merged into thicker ones, or lost among others."""
    less, more = root_uncertainty.merged_volume(
        roots, carved.bank, carved.silhouettes[0].coverage.shape, carved.hull.leaves.volume_mm3() / max(volume_mm3, 1e-9)
    )
    why = "many roots overlap, so that some may be merged into thicker ones, or lost if they are thinner than half a pixel"
    return Term(name="merged roots", less_mm3=less * volume_mm3, more_mm3=more * volume_mm3, why=why)


def _hidden_top(carved: CarvedHull, roots: Sequence[Root], leaves: Leaves) -> HiddenTop | None:
    """Estimate the parts of main roots that the net pot hides, above the top of their shape in the leaves.

    Main roots are roots without a parent. The result is None if there are no main roots, or if no part of them is
    hidden.
    """
    main = [root for root in roots if root.parent < 0]
    if not main:
        return None
    tops_mm = _tops_mm(main, leaves)
    return hidden_top.estimate_hidden(main, occlusion.gaps_mm(carved.bank, carved.maps, tops_mm, np.array([0.0, 0.0, 1.0]), carved.water))


def _tops_mm(roots: Sequence[Root], leaves: Leaves) -> NDArray[np.float64]:
    """Return the points (R, 3) at which the shapes of roots end above: level, or rounded by the radius."""
    tops_mm, radii_mm = np.array([root.points_mm[0] for root in roots]), np.array([0.5 * root.diameters_mm[0] for root in roots])
    middles_mm, half_mm = leaves.middles_mm, 0.5 * leaves.size * leaves.grid.size_mm
    high = (leaves.occupancy > 0.5) & (middles_mm[:, 2] > (tops_mm[:, 2] - radii_mm).min())
    middles_mm, upper_mm = middles_mm[high], (middles_mm[:, 2] + half_mm)[high]
    for top_mm, radius_mm in zip(tops_mm, radii_mm, strict=True):
        beside, above = np.hypot(*(middles_mm - top_mm)[:, :2].T), np.abs(upper_mm - top_mm[2])
        top_mm[2] = upper_mm[(beside <= radius_mm) & (above <= 2.0 * radius_mm)].max(initial=top_mm[2] - radius_mm)
    return tops_mm


def _add_hidden_top(budget: Budget, hidden: HiddenTop, *, extrapolate: bool) -> Budget:
    """Return a budget with the hidden tops of taproots: in the volume if extrapolated, else in the occluded parts."""
    if extrapolate:
        return replace(budget, volume_mm3=budget.volume_mm3 + hidden.volume_mm3, terms=(*budget.terms, hidden.term))
    terms = [replace(t, more_mm3=max(t.more_mm3, hidden.interval_mm3[1])) if t.name == "occluded" else t for t in budget.terms]
    return replace(budget, terms=tuple(terms))


def _calibration(carved: CarvedHull, shape: UnitedShape, budget: Budget, missed: float) -> Calibration:
    """Return the calibration of the 90 % intervals.

    Only scans with greyscale photographs of a canister with markers, and without a tank, are calibrated.
    """
    if carved.cameras.markers is None or carved.bank.optics.tank is not None or carved.is_binary:
        return NOT_CALIBRATED
    hidden_mm3 = sum(term.more_mm3 for term in budget.terms if term.name == "occluded")
    return find_calibration(
        views=carved.bank.count,
        px_a_mm=projection.px_a_mm(carved.bank, carved.water.centre_mm),
        missed=missed,
        translucent=shape.system is not None and not shape.system.attenuation.light.is_opaque,
        width_mm=rsml.mean_diameter_mm(shape.roots) if shape.roots else None,
        hidden=hidden_mm3 / max(budget.volume_mm3, 1e-9),
    )
