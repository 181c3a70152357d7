"""Appearance of a translucent root: two nested strips, which are narrower and fainter for thinner roots.

Let w be the radius of a round root, mu its attenuation, and theta the angle between its axis and the line of sight. At
the fraction x of its radius, the root has the chord ``2 w sqrt(1 - x^2) / sin(theta)`` and absorbs the fraction

    alpha(x) = 1 - exp(-2 tau sqrt(1 - x^2)),    tau = mu w / sin(theta)

of the light. Tissue also refracts. With an index n times that of water, a line of sight at x passes nearer to the axis,
at x / n' (Bouguer). The square root above is then replaced by ``sqrt(1 - x^2 / n'^2)``, and the rim is no longer
transparent. Here n' is the index in the cross-section, and theta' is the angle to the axis inside the root:

    1 - 1 / n'^2 = (n^2 - 1) / (n^2 sin^2(theta')),    cos(theta') = cos(theta) / n,    tau = mu w / sin(theta')

Divided into levels, alpha is a stack of strips of half-widths s, with ``integral x^(2k) alpha dx = 2 / (2k + 1)
integral s^(2k+1) dh``. Gauss quadrature of this stack (Golub and Welsch 1969, Math. Comp. 23:221) yields two strips of
half-widths e w and heights h with the same integrals of ``alpha``, ``x^2 alpha``, ``x^4 alpha`` and ``x^6 alpha``. If
pixels and blur are as wide as the root, pictures contain no more information.

Hairs of length l form a grey sleeve of attenuation m around the root. A line of sight then has the optical depth of a
disc of radius w + l and attenuation m, plus that of a disc of radius w and attenuation mu - m. The faint outer disc is
also represented by two strips, with the half-widths sin(72 deg) (w + l) and sin(36 deg) (w + l).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.coverage.translucency import Hairs
from rhizotwin.recon.device import TO_LAST, Bool, Float, numbers

Array = NDArray[np.float64]

LAYERS = 2
"""Number of strips that represent a root."""
_SLEEVE = (0.4 * np.pi, 0.5 + 0.05**0.5), (0.2 * np.pi, 0.5 - 0.05**0.5)
"""Two strips that represent a faint disc, from the wider to the narrower. The first value is the angle whose sine is
the half-width relative to the radius. The second value is the fraction of the absorbed light. They are the Gauss
quadrature of a semicircle, as described above."""
_FAINTEST = 0.1
"""Minimum attenuation of a root after subtraction of the hairs' attenuation, as a fraction of that before."""
HAIRS = Hairs(length_mm=0.3, mu_per_mm=0.05)
"""Typical root hairs of radish in water. They are 0.1 to 0.5 mm long and 10 um thick, with about thirty hairs per
millimetre of root.

The hairs absorb a third of the incident light and cover a seventh of each millimetre of the sleeve."""
_TAU = np.geomspace(1e-4, 50.0, 1201)
"""Tabulated optical depths of half a root. Linear interpolation is accurate to 1e-5. At larger optical depths, a root
is opaque to 1e-4 of its width."""
_RIM = np.linspace(0.0, 0.8, 33)
"""Tabulated ratios of the chord at the rim to the chord through the middle, sqrt(1 - 1 / n'^2). Linear interpolation is
accurate to 1e-4."""
_LEAST_SPREAD = 1e-9
"""Minimum variance of the squared half-widths of a root's strips. Below it, the root is represented by a single strip,
since the variance is only rounding error."""
_NODES = 400
"""Number of nodes in the Gauss-Legendre quadrature of the moments."""
LEAST_SINE = 0.2
"""Lower limit of the sine of the angle between root and line of sight. Smaller values are replaced by this limit, since
no root is straight for more than a few diameters."""


@dataclass(frozen=True)
class Layer:
    """Strip that represents a root in a picture. All fields are mi.Float."""

    half_px: Float
    height: Float
    by_width: Float
    """Ratio of two derivatives of the coverage: with respect to the root's half-width, and with respect to the
    half-width of an opaque strip of the same width."""
    by_height: Float
    """Derivative of the strip's opacity with respect to the root's half-width, 1/px."""


def layers(light: Light, radius_mm: Float, sine: Float, half_px: Float) -> list[Layer]:
    """Return the strips that represent roots in a picture.

    Without hairs, an opaque root is represented by a single strip.

    Parameters
    ----------
    light : Light
        Light parameters of the roots.
    radius_mm, half_px : Float
        Radius of the roots, mm, and half-width in the picture, px (mi.Float).
    sine : Float
        Sine of the angle between root axis and line of sight (mi.Float).
    """
    sine = dr.maximum(sine, LEAST_SINE)
    if light.is_opaque:
        own = [Layer(half_px, mi.Float(1.0), mi.Float(1.0), mi.Float(0.0))]
    else:
        less_per_mm = max(light.mu_per_mm - light.hairs * HAIRS.mu_per_mm, _FAINTEST * light.mu_per_mm)
        own = _translucent_strips(less_per_mm, light.index, radius_mm, sine, half_px)
    return _add_hairs(own, light.hairs, radius_mm, sine, half_px) if light.hairs else own


def _translucent_strips(mu_per_mm: float, index: float, radius_mm: Float, sine: Float, half_px: Float) -> list[Layer]:
    """Return the strips that represent translucent roots without hairs."""
    log_tau, table = _table()
    rows = numbers(np.moveaxis(table, (2, 3), (0, 1)))  # widths and heights of both strips, then their slopes
    square = dr.opaque(mi.Float, index**2)
    inside = dr.sqrt((square - 1 + dr.square(sine)) / square)
    rim = dr.minimum(dr.sqrt((square - 1) / square) / (inside * (_RIM[1] - _RIM[0])), len(_RIM) - TO_LAST)
    tau = dr.opaque(mi.Float, mu_per_mm) * radius_mm / inside
    place = (dr.log(dr.clip(tau, _TAU[0], _TAU[-1])) - log_tau[0]) / (log_tau[1] - log_tau[0])
    level, before = mi.UInt32(rim), dr.minimum(mi.UInt32(place), len(log_tau) - 2)
    between, part = rim - mi.Float(level), place - mi.Float(before)

    def read(k: int) -> mi.Vector4f:
        corners = [dr.gather(mi.Vector4f, rows, 2 * ((level + up) * len(log_tau) + before + on) + k) for up in (0, 1) for on in (0, 1)]
        low, high = (one * (1 - part) + other * part for one, other in (corners[:2], corners[2:]))
        return low * (1 - between) + high * between

    (e, h), (e_slope, h_slope) = (((four[0], four[1]), (four[2], four[3])) for four in (read(0), read(1)))
    return [Layer(half_px * e[n], h[n], h[n] * (e[n] + e_slope[n]), h_slope[n] / half_px) for n in range(LAYERS)]


def _add_hairs(own: list[Layer], strength: float, radius_mm: Float, sine: Float, half_px: Float) -> list[Layer]:
    """Return the strips of roots with hairs: those of the roots, and those of the sleeve."""
    px_a_mm, outer_mm = half_px / radius_mm, radius_mm + dr.opaque(mi.Float, HAIRS.length_mm)
    mu = dr.opaque(mi.Float, strength * HAIRS.mu_per_mm) / sine
    sleeve, left, left_slope = list[Layer](), mi.Float(1.0), mi.Float(0.0)  # transmittance of the wider strips, and its slope
    for turn, share in _SLEEVE:
        width = float(np.sin(turn))
        depth = (0.5 * np.pi * share / width) * mu  # per mm of the outer radius
        passing = dr.exp(-depth * outer_mm)
        slope = -passing * depth / px_a_mm
        height = left * (1 - passing)
        sleeve.append(Layer(width * outer_mm * px_a_mm, height, height * width, left_slope * (1 - passing) - left * slope))
        left, left_slope = left * passing, left_slope * passing + left * slope
    return [
        *(_behind(one, sleeve, [one.half_px <= other.half_px for other in sleeve]) for one in own),
        *(_behind(one, own, [one.half_px < other.half_px for other in own]) for one in sleeve),
    ]


def _behind(strip: Layer, others: list[Layer], hidden: list[Bool]) -> Layer:
    """Return a strip without the light that the wider ones of other strips absorb.

    Coverages A and S of two stacks of strips add to A + S - A S, where the product of two strips is as wide as the
    narrower one. ``hidden`` contains, for each of the others, whether it is wider.
    """
    passing, slope = mi.Float(1.0), mi.Float(0.0)
    for other, wider in zip(others, hidden, strict=True):
        passing -= dr.select(wider, other.height, 0.0)
        slope -= dr.select(wider, other.by_height, 0.0)
    return Layer(strip.half_px, strip.height * passing, strip.by_width * passing, strip.by_height * passing + strip.height * slope)


_RADII_MM = np.geomspace(1e-3, 30.0, 3001)
"""Radii at which the absorbed light is tabulated, mm, at relative intervals of 0.3 %."""


def equivalent_radius(opaque_mm: Array, light: Light) -> Array:
    """Return the radii (N,) of roots that absorb as much light as given opaque roots without hairs, mm.

    All roots are viewed from the side.

    Parameters
    ----------
    opaque_mm : (N,) float64 array
        Radii of the opaque roots, mm.
    light : Light
        Light parameters of the roots.
    """
    if light.is_opaque and not light.hairs:
        return opaque_mm
    area = np.log(opaque_radius(_RADII_MM, light))
    return np.asarray(np.exp(np.interp(np.log(opaque_mm), area, np.log(_RADII_MM))))


def opaque_radius(radius_mm: Array, light: Light) -> Array:
    """Return the radii (N,) of opaque roots without hairs that absorb as much light as given roots, mm.

    All roots are viewed from the side.

    Parameters
    ----------
    radius_mm : (N,) float64 array
        Radii of the given roots, mm.
    light : Light
        Light parameters of the roots.
    """
    width = numbers(radius_mm)
    found = mi.Float(0.0)
    for layer in layers(light, width, mi.Float(1.0), width):
        found += layer.half_px * layer.height
    return np.array(found, np.float64)


@cache
def _table() -> tuple[Array, Array]:
    """Return the tabulated log tau (T,), and the strips as an array (4, LAYERS, R, T).

    The first axis contains the ratio of the strip's half-width to the root's radius, the opacity of the strip, and
    their derivatives with respect to log tau. R is the number of ratios in `_RIM`.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    part = 0.5 * (node + 1.0)
    # x = cos(angle); more nodes at the rim, where the opacity of a dark root rises
    angle, share = 0.5 * np.pi * part**3, 0.75 * np.pi * weight * part**2
    x, by_angle = np.cos(angle), np.sin(angle) * share
    chord = np.sqrt(1.0 - np.square(x) * (1.0 - np.square(_RIM[:, None])))
    powers = np.stack([(2 * k + 1) * by_angle * x ** (2 * k) for k in range(2 * LAYERS)], axis=1)
    # moments of s^2, weighted with s dh: (4, R, T)
    moment = np.stack([-np.expm1(-2.0 * _TAU[:, None] * one) @ powers for one in chord]).transpose(2, 0, 1)
    mean = moment[1] / moment[0]
    variance = np.maximum(moment[2] / moment[0] - mean**2, _LEAST_SPREAD)
    skew = moment[3] / moment[0] - 3.0 * mean * moment[2] / moment[0] + 2.0 * mean**3
    other = mean + np.where(variance > _LEAST_SPREAD, skew / variance, 0.0)
    half = np.hypot(0.5 * (mean - other), np.sqrt(variance))
    middle = 0.5 * (mean + other)
    squares = np.stack([middle + half, middle - half])
    width = np.sqrt(squares)
    height = moment[0] * np.stack([mean - squares[1], squares[0] - mean]) / (2.0 * half) / width
    log_tau = np.log(_TAU)
    return log_tau, np.stack([width, height, np.gradient(width, log_tau, axis=2), np.gradient(height, log_tau, axis=2)])
