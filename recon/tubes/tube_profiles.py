"""Coverage profiles across the tubes, at every node in every view (Dr.Jit).

The profiles provide the residual coverage, and the derivatives of the coverage with respect to the node's position and
radius. At the offset o across a tube of half-width w, the derivative of the coverage is -(g(o + w) - g(o - w)) v with
respect to a lateral shift, and (g(o + w) + g(o - w)) v with respect to w. Here, g is the Gaussian of the pixel, and v
is the fraction that other tubes leave visible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import LIGHT
from rhizotwin.recon.device import Float, Kernel, UInt32, Vector3f, wholes
from rhizotwin.recon.tubes.system import Equations
from rhizotwin.recon.tubes.tube_picture import FULLEST, PIXEL_SIGMA, Rendering
from rhizotwin.recon.tubes.tube_sections import SAMPLES, Sections
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]

_INTERPOLATION_VARIANCE = 0.1
"""Variance of the blur caused by bilinear interpolation, px2."""
_ALONE = 0.95
"""Minimum transmittance of the other tubes beside a root for it to be considered a lone root, which no other root hides
or overlaps.

The transmittance on the root itself would be less reliable. Where the root almost covers a pixel, it is the quotient of
two small numbers."""
_LEAST_SINE = 0.3
"""Minimum sine of the angle between a root and the line of sight for the profile to be used for the light parameters.
At smaller angles, profiles depend more on bends of the root."""
OUTLIER = 0.05
"""Integral of the squared residual over a profile, px, at which the weight of the profile is halved, because it
probably shows another object.

Only coverage that the tubes do not explain is included, since it may be due to another root. Pixels that the tubes
cover but the picture shows empty are errors of the tubes."""


@dataclass(frozen=True)
class ResidualGradient:
    """Normal equations H x = g for the position and radius of each node, from the residuals of all views."""

    hessian: Array
    """Matrix H of each node for x, y, z and radius, shape (N, 4, 4)."""
    gradient: Array
    """Right-hand side g of each node for x, y, z and radius, shape (N, 4)."""
    visible: Array
    """Fraction of each node's coverage that no other tube hides, shape (N,). Both coverages are summed over the
    views."""

    def equations(self, mixed: Array) -> Equations:
        """Return the equations of nodes that follow given changes of K parameters.

        ``mixed`` (N, 4, K) is the derivative of the nodes' gradient with respect to these parameters.
        """
        many = mixed.shape[2]
        return Equations(self.hessian, self.gradient, mixed, np.zeros((many, many)), np.zeros(many))


@dataclass(frozen=True)
class HostProfiles:
    """Integrals over profiles across N nodes in V views, as NumPy arrays.

    Fields with ``width`` in their name contain the derivative of the coverage with respect to the half-width of the
    tube. ``whole`` is the coverage that the node would have without other tubes.
    """

    across: Array
    """Gradient of the node's lateral position in the picture with respect to its position in the canister frame, shape
    (V, N, 3), px/mm."""
    scale: Array
    """Image scale perpendicular to the tube, shape (V, N), px/mm."""
    shift_2: Array
    """Squared derivative of the coverage with respect to a lateral shift of the tube by 1 px, integrated over the
    profile, shape (V, N). It is 0 if the view does not show the node."""
    shift_width: Array
    width_2: Array
    shift: Array
    """Product of the residual and the derivative of the coverage with respect to the shift, integrated over the
    profile, shape (V, N)."""
    width: Array
    shown: Array
    """Coverage of the node that no other tube hides, integrated over the profile, shape (V, N)."""
    whole: Array


@dataclass(frozen=True)
class Changes:
    """Derivatives of the coverage in all views, computed as differences of renderings.

    They are mi.Float16, flattened (V, H, W). Analytic derivatives with a Gaussian edge are not accurate enough: along
    the valley in which wider, fainter roots look the same, less than a hundredth of the derivatives remains.
    """

    radius: Kernel
    """Derivative of the coverage with respect to the logarithm of all radii."""
    light: dict[int, Kernel]
    """Derivatives of the coverage with respect to selected parameters of `LIGHT`, keyed by their index."""


@dataclass(frozen=True)
class LightProfiles:
    """Integrals over profiles for the fit of the light parameters, flattened arrays of shape (V, N) on the device.

    Unless stated otherwise, they are 0 for roots that other roots hide or overlap.
    """

    by_shift: tuple[Float, ...]
    """Product of the derivatives of the coverage with respect to each parameter of `LIGHT` and to the shift. It is
    computed for all profiles."""
    by_width: tuple[Float, ...]
    """Product of the derivatives of the coverage with respect to each parameter of `LIGHT` and to the half-width. It is
    computed for all profiles."""
    shift_radius: Float
    """Product of the derivatives of the coverage with respect to the shift and to the radius (from `Changes`),
    px/mm."""
    radius_2: Float
    radius: Float
    """Product of the residual and the derivative of the coverage with respect to the radius, integrated over the
    profile."""
    by_radius: tuple[Float, ...]
    light_2: tuple[Float, ...]
    """Products of the derivatives of the coverage with respect to two parameters of `LIGHT`, in the order of the upper
    triangle of a matrix."""
    light: tuple[Float, ...]
    """Product of the residual and the derivative of the coverage with respect to each parameter of `LIGHT`."""


@dataclass(frozen=True)
class Profiles:
    """Integrals over profiles as in `HostProfiles`, but as flattened arrays of shape (V, N) on the device."""

    shape: tuple[int, int]
    across: Vector3f
    """Gradient of the node's lateral position in the picture with respect to its position in the canister frame, px/mm
    (mi.Vector3f). All other fields are mi.Float."""
    scale: Float
    shift_2: Float
    shift_width: Float
    width_2: Float
    shift: Float
    width: Float
    shown: Float
    whole: Float
    lone: Float
    """1 for lone roots, which no other root hides or overlaps. 0 for other roots."""
    light: LightProfiles | None = None

    @property
    def is_lone(self) -> NDArray[np.bool_]:
        """Mask (V, N) of the profiles that show a root that no other root hides or overlaps."""
        return np.array(self.lone).reshape(self.shape) > 0.0

    def host(self, nodes: NDArray[np.int64] | None = None) -> HostProfiles:
        """Return the profiles of all nodes, or of selected nodes (M,), as NumPy arrays."""
        views, count = self.shape
        chosen = np.arange(count) if nodes is None else nodes
        place = wholes(np.arange(views)[:, None] * count + chosen)

        def read(part: Float) -> Array:
            return np.array(dr.gather(mi.Float, part, place), np.float64).reshape(views, len(chosen))

        names = [field.name for field in fields(HostProfiles)[1:]]
        return HostProfiles(np.stack([read(part) for part in self.across], axis=-1), *(read(getattr(self, name)) for name in names))

    def residual_gradient(self) -> ResidualGradient:
        """Return the normal equations of the nodes, summed over all views."""

        def terms(at: UInt32) -> Iterator[Float]:
            """Yield the contributions of one view to the sums, for all nodes.

            These are the products of x, y, z and radius, the gradient, and the coverages.
            """
            parts = [dr.gather(mi.Float, part, at) for part in self.across]
            names = [field.name for field in fields(HostProfiles)[1:]]
            scale, shift_2, shift_width, width_2, shift, width, shown, whole = (
                dr.gather(mi.Float, getattr(self, name), at) for name in names
            )
            yield from (shift_2 * parts[i] * parts[j] for i in range(3) for j in range(i, 3))
            yield from (shift_width * scale * part for part in parts)
            yield width_2 * dr.square(scale)
            yield from (shift * part for part in parts)
            yield width * scale
            yield from (shown, whole)

        found = self._over_views(terms, 16)
        shown, whole = found[:, 14:].T
        return ResidualGradient(_symmetric(found[:, :10], _NODE), found[:, 10:14], shown / np.maximum(whole, 1e-9))

    def light_equations(self, thick: NDArray[np.bool_]) -> tuple[Array, Equations]:
        """Return the normal equations of nodes and light parameters.

        Returns
        -------
        by_light : (N, 4, L) array
            Derivative of each node's gradient (x, y, z, radius) with respect to each parameter of `LIGHT`, from all
            profiles.
        lone : Equations
            Joint equations of the nodes and `LIGHT`, from the profiles of roots that no other root hides or overlaps.
            Nodes in the mask ``thick`` (N,) do not contribute.
        """
        light, many = self.light, len(LIGHT)
        if light is None:
            raise ValueError("the profiles have no derivatives with respect to the light parameters; pass changes to profiles()")

        def terms(at: UInt32) -> Iterator[Float]:
            """Yield the contributions of one view to the sums, for all nodes.

            These are the products of x, y, z, radius and `LIGHT`, the gradient, and the elements of ``by_light``.
            """
            read = partial(dr.gather, mi.Float, index=at)
            parts, scale, lone = [read(part) for part in self.across], read(self.scale), read(self.lone)
            by_shift, by_width, by_radius = ([read(part) for part in group] for group in (light.by_shift, light.by_width, light.by_radius))
            for i in range(3):
                yield from (lone * read(self.shift_2) * parts[i] * parts[j] for j in range(i, 3))
                yield read(light.shift_radius) * parts[i]
                yield from (lone * part * parts[i] for part in by_shift)
            yield read(light.radius_2)
            yield from by_radius
            yield from (read(part) for part in light.light_2)
            yield from (lone * read(self.shift) * part for part in parts)
            yield read(light.radius)
            yield from (read(part) for part in light.light)
            yield from (part * along for along in parts for part in by_shift)
            yield from (part * scale for part in by_width)

        size = 4 + many
        products = size * (size + 1) // 2
        found = self._over_views(terms, products + size + 4 * many)
        by_light, lone = found[:, products + size :].reshape(-1, 4, many), np.where(thick[:, None], 0.0, found[:, : products + size])
        joint, (gradient, right) = _symmetric(lone[:, :products], np.triu_indices(size)), np.split(lone[:, products:], [4], axis=1)
        own = Equations(joint[:, :4, :4], gradient, joint[:, :4, 4:], joint[:, 4:, 4:].sum(axis=0), right.sum(axis=0))
        return by_light, own

    def _over_views(self, terms: Callable[[UInt32], Iterator[Float]], size: int) -> Array:
        """Return the sums (N, size) of the contributions of all views.

        ``terms`` yields the contributions of one view, ``size`` in number.
        """
        count = self.shape[1]
        views, nodes = (dr.opaque(mi.UInt32, size) for size in self.shape)

        def body(view: UInt32, at: UInt32, *sums: Float) -> tuple[Kernel, ...]:
            return view + 1, at + nodes, *(total + term for total, term in zip(sums, terms(at), strict=True))

        begin = dr.zeros(mi.UInt32, count), dr.arange(mi.UInt32, count), *(dr.zeros(mi.Float, count) for _ in range(size))
        sums = dr.while_loop(begin, lambda view, *_: view < views, body)[2:]
        dr.eval(sums)
        return np.stack([np.array(total, np.float64) for total in sums], axis=-1)


_NODE = np.array([0, 0, 0, 1, 1, 2, 0, 1, 2, 3]), np.array([0, 1, 2, 1, 2, 2, 3, 3, 3, 3])
"""Rows and columns of a node's normal matrix, for its ten distinct elements in the order in which they are summed. The
parameters are x, y, z and radius."""


def _symmetric(products: Array, place: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Array:
    """Return symmetric matrices (N, K, K) with given elements (N, P).

    ``place`` contains the rows and columns (P,) of the elements. Their mirror images have the same values.
    """
    row, column = place
    size = int(column.max()) + 1
    found = np.empty((len(products), size, size))
    found[:, row, column] = found[:, column, row] = products
    return found


def profiles(drawn: Rendering, changes: Changes | None = None, *, every: bool = False) -> Profiles:
    """Compare pictures and rendered tubes along the profiles across every node in every view.

    Parameters
    ----------
    drawn : Rendering
        Rendered tubes.
    changes : Changes, optional
        Derivatives with respect to the light parameters. Without them, no light equations are computed.
    every : bool
        Whether all profiles are used for the light parameters, because profiles of lone roots are too few.
    """
    evidence, at = drawn.evidence, drawn.at
    cut = Sections.cut(evidence, drawn.tubes, at)
    if cut is None:
        return _assemble(at.shape, [dr.zeros(mi.Float, at.shape[0] * at.shape[1])] * _size(changes), changes)
    sigma = float(np.sqrt(evidence.light.blur_px**2 + PIXEL_SIGMA**2 + _INTERPOLATION_VARIANCE))
    per_px, peak = (dr.opaque(mi.Float, 1.0 / (sigma * root)) for root in (2.0**0.5, (2.0 * np.pi) ** 0.5))

    def body(k: UInt32, *sums: Float) -> tuple[Kernel, ...]:
        o = cut.at_edge(k)
        d, passing = cut.read(o, drawn.difference, drawn.passing)
        c, shift, width = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        for layer in cut.layers:
            plus, minus = (o + layer.half_px) * per_px, (o - layer.half_px) * per_px
            g_plus, g_minus = (peak * dr.exp(-dr.square(edge)) for edge in (plus, minus))
            box = 0.5 * (dr.erf(plus) - dr.erf(minus))
            c += layer.height * box
            shift += layer.height * (g_minus - g_plus)
            width += layer.by_width * (g_plus + g_minus) + layer.by_height * box
        c = dr.minimum(c, FULLEST)
        visible = dr.minimum(passing / (1 - c), 1.0)  # fraction that the other tubes leave visible
        shift, width = shift * visible, width * visible
        terms = (shift * shift, shift * width, width * width, shift * d, width * d, visible * c, c)
        about = dr.square(dr.maximum(d, 0.0)), passing, 1 - c
        of_light = () if changes is None else _light_terms(cut, o, changes, shift, width, d)
        return k + 1, *(total + term for total, term in zip(sums, (*terms, *about, *of_light), strict=True))

    many = _size(changes) - 5  # excluding direction, scale and lone
    begin = dr.zeros(mi.UInt32, cut.count), *(dr.zeros(mi.Float, cut.count) for _ in range(many + 3))
    sums = list(dr.while_loop(begin, lambda k, *_: k < SAMPLES, body)[1:])
    uncovered, passing, passing_alone = sums[7:10]
    step = cut.edge_step
    weight = step / (1.0 + uncovered * step / OUTLIER)
    alone = dr.select((passing > _ALONE * passing_alone) & (cut.sine > _LEAST_SINE) | every, mi.Float(1.0), 0.0)
    of_all = 2 * len(LIGHT)
    factors = [weight] * 5 + [step] * 2 + [weight] * of_all + [weight * alone] * (many - 7 - of_all)
    summed = [total * factor for total, factor in zip(sums[:7] + sums[10:], factors if changes else factors[:7], strict=True)]
    found = [cut.spread(part) for part in (*cut.across, cut.scale, alone, *summed)]
    dr.eval(found)  # evaluated together, so that the profiles are traversed only once
    return _assemble(cut.shape, found, changes)


def _light_terms(cut: Sections, o: Float, changes: Changes, shift: Float, width: Float, d: Float) -> Iterator[Float]:
    """Yield the contributions of one sample to the fields of `LightProfiles`, in their order.

    The sample has the offset ``o`` from the centre line.
    """
    (radius,) = cut.read(o, changes.radius)
    radius *= cut.scale / cut.half_px  # derivative per mm
    light = [cut.read(o, changes.light[k])[0] if k in changes.light else mi.Float(0.0) for k in range(len(LIGHT))]
    yield from (shift * part for part in light)
    yield from (width * part for part in light)
    yield from (shift * radius, radius * radius, radius * d)
    yield from (radius * part for part in light)
    yield from (light[i] * light[j] for i in range(len(light)) for j in range(i, len(light)))
    yield from (part * d for part in light)


def _size(changes: Changes | None) -> int:
    """Return the number of values that are stored for each profile."""
    many = len(LIGHT)
    return 12 if changes is None else 12 + 4 * many + 3 + many * (many + 1) // 2


def _assemble(shape: tuple[int, int], parts: list[Float], changes: Changes | None) -> Profiles:
    """Assemble profiles from their values, in the order in which `profiles` computes them."""
    x, y, z, scale, lone, shift_2, shift_width, width_2, shift, width, shown, whole, *rest = parts
    across, many = mi.Vector3f(x, y, z), len(LIGHT)
    light = None
    if changes is not None:
        shift_radius, radius_2, radius = rest[2 * many : 2 * many + 3]
        others = rest[: 2 * many] + rest[2 * many + 3 :]
        by_shift, by_width, by_radius = (tuple(others[k * many : (k + 1) * many]) for k in range(3))
        light_2, of_light = tuple(others[3 * many : -many]), tuple(others[-many:])
        light = LightProfiles(by_shift, by_width, shift_radius, radius_2, radius, by_radius, light_2, of_light)
    return Profiles(shape, across, scale, shift_2, shift_width, width_2, shift, width, shown, whole, lone, light)


def misfit(evidence: Evidence, tubes: Tubes, difference: Float) -> Array:
    """Return the integral of the squared residual over both edges of the tube, for every view and node (V, N), px.

    The result is NaN where a view does not show the node.

    Parameters
    ----------
    tubes, difference : Tubes, Float
        Tubes, and residual coverage of their rendering (`Rendering`).
    """
    at = evidence.project(tubes.centre_mm)
    cut = Sections.cut(evidence, tubes, at)
    whole = np.full(at.shape, np.nan)
    if cut is not None:
        total = dr.zeros(mi.Float, cut.count)
        for k in range(SAMPLES):
            total += dr.square(cut.read(cut.at_edge(k), difference)[0])
        whole.ravel()[np.array(cut.place)] = np.array(total * cut.edge_step)
    return whole
