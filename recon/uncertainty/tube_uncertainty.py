"""Uncertainty of the volume of the tubes, with one term for each cause."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes import root_light, tube_fit
from rhizotwin.recon.tubes.root_light import HAIRS
from rhizotwin.recon.tubes.tube_profiles import HostProfiles
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.recon.uncertainty.budget import NINETY, Term
from rhizotwin.recon.uncertainty.posterior import Posterior
from rhizotwin.recon.uncertainty.root_residual import draw_discs

Array = NDArray[np.float64]

_INSIDE = 0.3
"""Minimum coverage of the pixels from which the width of missing roots is measured. The width is accurate to one or two
pixels."""
_FLAT, _FLAT_PX = 0.1, 0.1
"""Minimum variation of a root's half-width between views for the root to be considered flat: relative to the radius,
and in pixels."""
_FLATTEST = 0.26
"""Maximum relative variation of a root's half-width between views. It is that of two equal touching roots of radius r:
their half-width is r + r |cos|, on average r (1 + 2 / pi), with the second harmonic 4 r / (3 pi)."""
_HAIRS_KNOWN = 0.5
"""Relative uncertainty of the light that hairs absorb. It is due to the length of the hairs, which varies from 0.1 to
0.5 mm."""
_OVAL = 0.01
"""Maximum relative error of a thick root's volume if its cross-section is assumed to be a circle of its mean width. The
true volume is smaller. This error occurs for an ellipse with axes in the ratio 6 to 7, and for a regular polygon with
18 sides."""
_FLAT_NODES = 5
"""Number of nodes over which the shape of the cross-section is assumed to be constant, which corresponds to 3 mm."""
_LEAST_FREE = 0.1
"""Minimum fraction of the root zone that is not covered by tubes in the estimate of hidden roots. Smaller fractions are
replaced by this one."""
_ZONE = (0.02, 0.98)
"""Two quantiles of the row and column numbers of covered pixels, which bound the root zone in a picture."""


@dataclass(frozen=True)
class TubeUncertainty:
    """Terms of the error budget for the tubes, and two quantities on which the verdict depends."""

    terms: tuple[Term, ...]
    unexplained: float
    fill: float


def estimate(posterior: Posterior) -> TubeUncertainty:
    """Compute the error of the volume of the fitted tubes from the residuals of the pictures."""
    system, tubes = posterior.system, posterior.system.tubes
    gain = np.where(system.solid, 0.0, 2.0 * np.pi * tubes.radius_mm * _lengths(tubes))  # derivative of the volume by the radius
    wish = gain @ posterior.view_steps_mm  # change of the volume that each view would cause
    total = float(wish.sum())
    rest = _Residual.compute(posterior)
    tube_mm3 = float(0.5 * gain @ tubes.radius_mm)
    views = NINETY * float(np.sqrt(len(wish) * np.var(wish)))
    # errors of hidden radii are assumed to be equal along a branch, and independent between branches
    hidden = NINETY * float(np.linalg.norm(np.bincount(tubes.owner, weights=gain * posterior.unconstrained_mm)))
    balance = 2.0 * rest.balance * tube_mm3  # areas grow with the radius, volumes with its square
    missing = rest.missing_px3 / system.px_a_mm**3
    flat = float(0.5 * (gain * tubes.radius_mm) @ _flatness(tubes, posterior.profiles, system.px_a_mm))
    ends = float(0.5 * gain @ (tubes.radius_mm * system.uncertain))
    oval = _OVAL * float(0.5 * gain @ (tubes.radius_mm * system.thick))
    terms = (
        Term.symmetric("radii, view against view", views, "the views disagree on the radii of the tubes (noise, poses, backlight)"),
        Term.symmetric(
            "radii, hidden", hidden, "some roots are hidden by others in most views, so that their radii are hardly constrained"
        ),
        _one_sided(
            "radii, residual gradient",
            total,
            "the smoothness of branches keeps the radii from fully matching the pictures",
        ),
        _one_sided("area", balance, "the area covered by the tubes differs from that in the pictures"),
        *_light(system, gain @ posterior.by_light),
        Term.symmetric("uncertain ends", ends, "ends whose tips are hidden by others may not be roots"),
        Term(name="flat roots", less_mm3=flat, more_mm3=0.0, why="some roots appear flat, and may be two roots side by side"),
        Term(name="sections", less_mm3=oval, more_mm3=0.0, why="thick roots are assumed round, and have less volume where they are not"),
        Term(name="missing roots", less_mm3=0.0, more_mm3=float(missing), why="the pictures show coverage far from all tubes"),
    )
    return TubeUncertainty(terms, rest.unexplained, rest.fill)


def _light(system: RootSystem, by_light: Array) -> tuple[Term, ...]:
    """Return the terms of the error budget for attenuation, blur and hairs.

    ``by_light`` (L,) is the derivative of the volume with respect to the light parameters. It includes the change of
    the radii that keeps the absorbed light constant.
    """
    attenuation, light = system.attenuation, system.evidence.light
    half = NINETY * float(np.sqrt(by_light @ attenuation.covariance @ by_light))
    if light.is_opaque:
        terms = [Term.symmetric("radii, blur", half, "radii depend on the pictures' blur")]
        if attenuation.rival_per_mm is not None:
            more = _volume_change(system, replace(light, mu_per_mm=attenuation.rival_per_mm))
            why = f"roots may be translucent ({attenuation.rival_per_mm:.2g} per mm): opaque roots explain the pictures almost as well"
            terms.append(Term(name="translucency", less_mm3=0.0, more_mm3=more, why=why))
        if attenuation.hairs == "maybe":
            change = _volume_change(system, replace(light, hairs=1.0))
            terms.append(_one_sided("hairs", change, "the pictures do not show whether the roots have hairs"))
        return tuple(terms)
    why = f"the roots are translucent, and their attenuation is only known to {100.0 * attenuation.sigma:.0f} %"
    terms = [Term.symmetric("translucency", half, why)]
    if attenuation.hairs != "none":
        why = "the roots have hairs, whose absorption depends on their length, which is only known to 50 %"
        terms.append(Term.symmetric("hairs", _HAIRS_KNOWN * abs(float(by_light[HAIRS]) * light.hairs), why))
    return tuple(terms)


def _volume_change(system: RootSystem, other: Light) -> float:
    """Return the change of the volume if the light parameters change, mm3.

    The radii change with them, so that the roots absorb the same light.
    """
    tubes = root_light.match_absorption(system.tubes, system.solid, system.evidence.light, other)
    return float(np.pi * (np.square(tubes.radius_mm) - np.square(system.tubes.radius_mm)) @ _lengths(tubes))


def _one_sided(name: str, change_mm3: float, why: str) -> Term:
    return Term(name=name, less_mm3=max(0.0, -change_mm3), more_mm3=max(0.0, change_mm3), why=why)


def _lengths(tubes: Tubes) -> Array:
    """Return the length (N,) of tube that each node represents, mm.

    It is half of each segment at the node. However, the whole first segment of a branch with a parent belongs to its
    second node.
    """
    half = np.zeros(len(tubes.radius_mm))
    for k, nodes in enumerate(tubes.branches):
        step = 0.5 * np.linalg.norm(np.diff(tubes.centre_mm[nodes], axis=0), axis=1)
        np.add.at(half, nodes[1:], step)
        np.add.at(half, nodes[:-1] if k == 0 else np.concatenate([nodes[1:2], nodes[1:-1]]), step)
    return half


def _flatness(tubes: Tubes, profiles: HostProfiles, px_a_mm: float) -> Array:
    """Return the relative variation (N,) of each root's half-width between views.

    It is 0 for round roots. The variation is evaluated at each node.

    The half-widths in the views, w + u S u across the direction u, are fitted with a symmetric tensor S, constant over
    a few nodes. Its eigenvalues across the tube differ by twice the second harmonic. Two equal touching roots of radius
    r, modelled as a round one, have the flatness `_FLATTEST` and 0.75 of that one's volume: the relative volume error
    of a double root is its flatness.
    """
    unit = profiles.across / np.maximum(profiles.scale, 1e-9)[..., None]
    x, y, z = np.moveaxis(unit, -1, 0)
    parts = np.stack([x * x, y * y, z * z, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z], axis=-1)
    square = np.einsum("vn,vni,vnj->nij", profiles.width_2 * profiles.scale**2, parts, parts, optimize=True)
    wish = np.einsum("vn,vni->ni", profiles.width * profiles.scale, parts)
    for k in range(len(tubes.branches)):
        own = tubes.own(k)
        for value in (square, wish):
            value[own] = uniform_filter1d(value[own], _FLAT_NODES, axis=0, mode="nearest")
    tensor = np.linalg.solve(square + tube_fit.LEAST * np.eye(6), wish[..., None])[..., 0][:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    tangent = tubes.tangents
    plane = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]
    section = plane @ tensor @ plane
    trace = np.trace(section, axis1=1, axis2=2)
    harmonic = 0.5 * np.sqrt(np.maximum(2.0 * (section**2).sum(axis=(1, 2)) - trace**2, 0.0))
    share = harmonic / tubes.radius_mm
    return np.where((share > _FLAT) & (harmonic * px_a_mm > _FLAT_PX), np.minimum(share, _FLATTEST), 0.0)


@dataclass(frozen=True)
class _Residual:
    """Residuals of the pictures after subtraction of the tubes' coverage."""

    balance: float
    """Sum of the residual over the pixels on the tubes and within two pixels of them, divided by the area that the
    tubes cover."""
    missing_px3: float
    """Volume of coverage far from tubes, in cubic pixels. It includes an estimate of the roots that tubes hide.

    It is the covered area times the depth, which is a quarter of pi times the width. For faint translucent roots, the
    covered area is smaller, but the volume is still proportional to the absorption."""
    unexplained: float
    """Fraction of all covered area that is far from tubes."""
    fill: float
    """Fraction of the root zone that thin roots cover, outside thick roots. Median of the views."""

    @staticmethod
    def compute(posterior: Posterior) -> _Residual:
        """Compute the residuals of all views.

        Views are evaluated one after the other, to limit memory.
        """
        system, drawn, near = posterior.system, posterior.system.rendering, posterior.near
        known, left = (np.array(picture).reshape(near.shape) for picture in (system.evidence.usable, drawn.difference))
        radius_px, views = system.tubes.radius_mm[system.thick] * system.px_a_mm, []
        for k, silhouette in enumerate(system.evidence.silhouettes):
            thick = draw_discs(drawn.at.px[k, system.thick], radius_px, near.shape[1:])
            views.append(_ViewResidual.compute(system, silhouette, known[k] > 0, near[k], thick, left[k].astype(np.float32)))
        area = float((drawn.coverage * (known > 0)).sum(dtype=np.float64))
        beyond = max(0.0, sum(view.beyond for view in views))
        fills, missing = ([view.fill for view in views if view.has_roots], [view.missing_px3 for view in views if view.has_roots])
        return _Residual(
            balance=sum(view.balance for view in views) / max(area, 1.0),
            missing_px3=max(0.0, float(np.mean(missing))) if missing else 0.0,
            unexplained=beyond / max(area + sum(view.hidden for view in views) + beyond, 1.0),
            fill=float(np.median(fills)) if fills else 0.0,
        )


@dataclass(frozen=True)
class _ViewResidual:
    """Residuals of one view. Areas are in pixels."""

    hidden: float
    """Area covered by taproot, hypocotyl and solids, where tubes are masked."""
    balance: float
    """Sum of the residual over the pixels on the tubes and within two pixels of them."""
    beyond: float
    """Sum of the residual over all pixels that are farther than two pixels from the tubes."""
    has_roots: bool
    fill: float = 0.0
    missing_px3: float = 0.0

    @staticmethod
    def compute(system: RootSystem, picture: Silhouette, known: Mask, near: Mask, thick: Mask, left: Image) -> _ViewResidual:
        """Compare a picture with the tubes.

        Parameters
        ----------
        known : (H, W) bool array
            Mask of usable pixels.
        near, thick : (H, W) bool array
            Masks of pixels on the tubes and within two pixels of them, and of pixels that thick roots cover.
        left : (H, W) float32 array
            Residual.
        """
        far = left * ~near
        far *= picture.coverage > 0.0  # ignore values at the noise level
        rest = _ViewResidual(
            hidden=float((picture.coverage * picture.usable * ~known).sum(dtype=np.float64)),
            balance=float(left[near].sum(dtype=np.float64)),
            beyond=float(far.sum(dtype=np.float64)),
            has_roots=False,
        )
        rows, columns = np.nonzero((picture.coverage > 0.5) & picture.usable)
        if not len(rows):
            return rest
        (top, bottom), (first, last) = np.quantile(rows, _ZONE).astype(int), np.quantile(columns, _ZONE).astype(int)
        zone = np.s_[top : bottom + 1, first : last + 1]
        inside = cv2.distanceTransform((picture.coverage > _INSIDE).astype(np.uint8), cv2.DIST_L2, 3)
        width_px = np.maximum(2.0 * cv2.dilate(inside, np.ones((7, 7), np.uint8)) - 1.0, 1.0)
        # absorption of faint roots is proportional to their volume
        depth_px = np.maximum(0.25 * np.pi * width_px, system.px_a_mm / system.evidence.light.mu_per_mm)
        volume = float((far * depth_px).sum(dtype=np.float64))
        missing = volume / max(1.0 - float(near[zone].mean()), _LEAST_FREE)
        thin = np.where(known, picture.coverage, 0.0)[zone][~thick[zone]]
        return replace(rest, has_roots=True, fill=float(thin.mean()) if thin.size else 0.0, missing_px3=missing)
