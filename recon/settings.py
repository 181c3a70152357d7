"""User settings of the reconstruction; other values are derived, or constants in the code."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.reading import read_file
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Calibration of the cameras from markers and the canister's edges."""

    worst_px: float = bounded(1.0, 0.05, 100.0)
    """Reprojection error (px) beyond which a view is excluded, if it is also `worst_factor` times the median. Typical
    errors are 0.03 to 0.06, and 0.1 to 0.4 with OpenCV's corners. An error of one pixel in one view reduces the width
    of every root by a pixel: 0.23 mm on a bench, where second-order laterals have 0.14 to 0.28 mm."""
    worst_factor: float = bounded(6.0, 1.0, 1000.0)
    """Ratio of a view's reprojection error to the median beyond which it is excluded, see `worst_px`. Errors are means
    over tens of corners, so that those of the views of one scan differ by tens of per cent, not by factors."""
    hopeless_px: float = bounded(5.0, 0.05, 1000.0)
    """Reprojection error (px) beyond which a view is always excluded: the width of every root is reduced by the error
    of one view, and 5 px (1.2 mm on a bench) exceed the width of any lateral, and of a taproot up to its fifteenth day.
    """
    focus_sure: float = bounded(5.0, 0.0, 100.0)
    """Number of standard deviations beyond which a change of focus since the calibration of the lens is accepted: its
    effect resembles that of distance, whose uncertainty increases two to three times while the focus is free
    (`docs/log/self-calibration.md`)."""
    focus_prior: float = bounded(0.005, 1e-6, 0.1)
    """Standard deviation of the ratio of focal lengths to the calibrated ones; focusing changes them by fractions of a
    per cent."""
    table_prior_deg: float = bounded(0.1, 1e-4, 30.0)
    """Standard deviation (degrees) of the table's angles from the commanded ones; the pictures determine them a hundred
    times more precisely."""
    inset_prior_px: float = bounded(0.05, 1e-4, 2.0)
    """Standard deviation of the apparent enlargement of markers on each side (px); in the twin it is 0.11 for sRGB and
    0.002 for linear light."""
    edge_mm: float = bounded(0.1, 0.001, 5.0)
    """Scale (mm) of the Cauchy loss for the canister's edges: about a third of a pixel on a bench, and ten times the
    noise of the edges."""


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """Measurement of the coverage of each pixel by roots."""

    noise_sigmas: float = bounded(4.0, 0.0, 20.0)
    """Minimum darkening (smoothed by a Gaussian of one pixel) that counts as coverage, in standard deviations of the
    noise of the empty backlight; 15 of 480 000 empty pixels exceed the default by chance."""
    dim: float = bounded(0.25, 0.0, 1.0)
    """Brightness of the background, relative to the ring's bright one (its 90 % quantile), below which pixels are not
    usable, as at flanks and in shadows."""
    glare: float = bounded(0.05, 0.001, 1.0)
    """Brightness above the smooth panel, relative to it, beyond which a pixel shows a reflection. A reflection is
    subtracted if roots in front of it confirm that its light is not the panel's; otherwise its pixels are not usable.
    """
    film_depth: float = bounded(0.03, 0.001, 2.0)
    """Minimum optical depth of a detected film on the wall; those of the profile `harsh` are measured within 0.01
    (`docs/log/silhouettes-from-coverage.md`)."""
    film_most: float = bounded(0.5, 0.01, 10.0)
    """Maximum optical depth of a film; darker structures are objects."""
    bubble_depth: float = bounded(0.06, 0.001, 2.0)
    """Mean optical depth of one millimetre of wall with the smallest detected bubble: twice that of the faintest film.
    """


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """Selection of pictures."""

    leave_out: tuple[str, ...] = ()
    """Pictures to exclude, by their file names in the dataset, or by the ends of these names."""
    tolerant: bool = False
    """Exclude pictures that are missing or cannot be read, instead of stopping with an error."""
    band: str = ""
    """Name of the camera's band used for the roots; by default the one with the largest signal-to-noise ratio."""

    def joined(self, other: PictureSettings) -> PictureSettings:
        """Return settings that exclude the pictures of both, and are tolerant if one of them is."""
        return PictureSettings(
            leave_out=(*self.leave_out, *other.leave_out), tolerant=self.tolerant or other.tolerant, band=self.band or other.band
        )


@dataclass(frozen=True, kw_only=True)
class HullSettings:
    """Carving of the hull from silhouettes."""

    finest_mm: float = bounded(0.14, 0.01, 5.0)
    """Maximum edge of carved voxels; larger output voxels are assembled from these, so that their occupancy is
    measured."""
    slack_px: float = bounded(0.3, 0.01, 5.0)
    """Displacement of outlines inwards and outwards for the silhouette-consistent bounds."""
    extrapolate_taproot: bool = False
    """Add the volume of a taproot behind the net pot, extrapolated from its visible part; the shape does not change."""


@dataclass(frozen=True, kw_only=True)
class TrustSettings:
    """Limits of a trusted volume. Of two limits, values beyond the first are fair, and beyond the second bad."""

    widest: float = bounded(0.25, 0.0, 10.0)
    """Maximum half-width of the 90 % interval relative to the volume: two scans a week apart with this half-width do
    not resolve growth by a third."""
    least_views: int = bounded(8, 3, 1000)
    """Minimum number of views; with fewer, no view may be left to contradict a ghost."""
    unexplained: tuple[float, float] = bounded((0.1, 0.2), 0.0, 1.0)
    """Fraction of the covered area that the shape leaves unexplained; beyond the limit, too many roots were missed to
    estimate their volume."""
    fill: tuple[float, float] = bounded((0.35, 0.5), 0.0, 1.0)
    """Fraction of the root zone covered by thin roots in the pictures: above one half, silhouettes no longer
    distinguish roots from gaps."""
    missed: tuple[float, float] = bounded((0.05, 0.1), 0.0, 1.0)
    """Fraction of the coverage outside the hull of all views: views with inconsistent geometry carve roots away. It is
    up to 0.03 for plants and printed phantoms of the ladder, and 0.06 for correct mixtures; for wrong ones (24 to 37 %
    of the volume lost) it is 0.20 or more. The limit is the geometric mean of the two
    (`docs/log/2026-11-22-mixtures.md`)."""
    sway_mm: tuple[float, float] = bounded((0.06, 0.15), 0.0, 10.0)
    """Root mean square displacement (mm) of the roots in a picture from their position in all pictures. It is 0.023 to
    0.059 for static plants in the twin. Motion widens the common shape by its square, and a sway of 0.3 mm lost 10 % of
    the volume: the limits correspond to 0.4 and 2.5 %. Wrong cameras have 0.48 (a cropped picture) and 0.89 (one of
    half the size)."""
    dirt: tuple[float, float] = bounded((0.1, 0.35), 0.0, 1.0)
    """Fraction of the wall in front of the roots that films, bubbles and glare cover."""
    spread: tuple[float, float] = bounded((0.02, 0.04), 0.0, 1.0)
    """Scattered light: light missing beside roots, relative to the light they absorb
    (`recon.uncertainty.scattered_light`). It is 0.000 to 0.007 for printed phantoms and plants in `clean`, `bench` and
    `camera`. A quarter of the light scattered over 20 px gives 0.19, and made a printed phantom 5.9 % too large: the
    limits correspond to 0.6 and 1.2 % of volume (`docs/log/2026-11-22-damages.md`)."""
    clipped: tuple[float, float] = bounded((0.002, 0.02), 0.0, 1.0)
    """Fraction of the panel's pixels at full scale: where the panel is clipped, the absorption by roots is unknown."""
    dim: tuple[float, float] = bounded((0.2, 0.05), 0.0, 1.0)
    """Minimum brightness of the panel: at a twentieth of full scale, eight bits have 13 levels, and a root half a pixel
    wide three of them."""
    wander: tuple[float, float] = bounded((0.05, 0.3), 0.0, 10.0)
    """Standard deviation of the exposure, which is normalised; a variation by a third moves the panel out of the
    camera's range."""
    uneven: tuple[float, float] = bounded((0.015, 0.04), 0.0, 1.0)
    """Standard deviation of the panel beside the canister relative to that of all pictures, after normalisation of the
    exposure row by row. Bands of 7 % without this normalisation made a printed phantom 6.8 % too large, which is about
    the same (`docs/log/2026-11-22-damages.md`)."""
    blur_px: tuple[float, float] = bounded((1.2, 2.5), 0.0, 100.0)
    """Standard deviation (px) of the blur, including the pixel's own 0.29. A root of 0.3 mm is one pixel wide at 800
    pixels across 250 mm; blurred by 2.5 px, it darkens the panel by a sixth."""
    refocus_px: tuple[float, float] = bounded((0.5, 1.0), 0.0, 100.0)
    """Additional blur (px) of the least sharp picture relative to the sharpest, as a difference of variances. All
    pictures are fitted with one blur: with half of a printed phantom's pictures blurred by an additional 1.5 px, 9.3 %
    of its volume was lost; the loss grows with the square, so that 1 px corresponds to 4 % and 0.5 px to 1 %. It is 0.1
    for plants and printed phantoms in `bench`, `camera` and mixtures."""
    inset_px: tuple[float, float] = bounded((0.03, 0.045), 0.0, 10.0)
    """Apparent enlargement of the markers on each side (px): in linear light, blur does not move their edges. It is
    0.001 to 0.005 for correct scans of the twin, and 0.028 for an uncalibrated lens of k1 = -0.15, with a volume
    correct to 1.1 %. It is 0.077 for a table that turns by 4 px during the exposure, with a volume 6.9 % too large, and
    0.11 for sRGB interpreted as light. The second limit is the geometric mean of the largest value of a correct scan
    and the smallest value of a wrong one."""
    corners_px: tuple[float, float] = bounded((0.3, 1.0), 0.0, 100.0)
    """Distance (px) of the markers' corners from their projections by the cameras; fitted corners are within 0.06, and
    OpenCV's corners within 0.2 at 800 pixels and 0.4 at 400 (measured)."""
    radius_share: tuple[float, float] = bounded((0.002, 0.006), 0.0, 1.0)
    """Relative deviation of the canister's outer radius from its nominal value that remains after correction, which
    changes the strength of the canister as a lens by the same fraction."""
    edge_mm: tuple[float, float] = bounded((0.06, 0.15), 0.0, 10.0)
    """Deviation of the canister's edges from an oval (mm, median)."""
    oval_mm: tuple[float, float] = bounded((0.12, 0.3), 0.0, 10.0)
    """Half the difference between the canister's radii (mm). A wall inclined by 2 e / R deflects a ray by a quarter of
    that (index 1.33), which displaces a root on the axis by e / 2, as much as ``sway_mm`` permits."""
    resolution_px: tuple[float, float] = bounded((0.7, 0.0), 0.0, 100.0)
    """Minimum width of thin roots in the pictures (px). The views of a radish of five days are inconsistent at 0.61,
    but not at 0.75 and 0.95; the first limit is the geometric mean. No width alone is bad: if the views are consistent,
    the volume is correct."""
    left_out: tuple[float, float] = bounded((0.1, 0.34), 0.0, 1.0)
    """Fraction of the pictures that could not be used."""
    gap_deg: tuple[float, float] = bounded((30.0, 75.0), 0.0, 360.0)
    """Maximum step (degrees) between neighbouring views around the canister; between them, the shape is only
    constrained by these two views."""

    def __post_init__(self) -> None:
        """Check the order of the limits; only low brightness of the panel and small widths of roots are bad."""
        for each in fields(self):
            value = getattr(self, each.name)
            is_small_bad = each.name in ("dim", "resolution_px")
            if isinstance(value, tuple) and (value[0] < value[1] if is_small_bad else value[0] > value[1]):
                side = "above" if is_small_bad else "below"
                raise UserError(f"[trust] {each.name} = {list(value)}: the second limit must not be {side} the first")


@dataclass(frozen=True, kw_only=True)
class ShootSettings:
    """Measurement of the shoot."""

    leaf_thickness_mm: float = bounded(0.0, 0.0, 10.0)
    """Thickness of a blade (mm), measured with a caliper or from the mass of a punched disc; 0 if unknown, in which
    case the volume of the shoot is not computed. Blades are about one pixel thick (0.3 mm), which silhouettes do not
    resolve."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a reconstruction, with a group for each stage."""

    voxel_mm: float = bounded(0.27, 0.01, 20.0)
    """Edge of the voxels in the output (0.27 as in the thesis); volumes are measured on a finer grid."""
    pictures: PictureSettings = field(default_factory=PictureSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    coverage: CoverageSettings = field(default_factory=CoverageSettings)
    hull: HullSettings = field(default_factory=HullSettings)
    trust: TrustSettings = field(default_factory=TrustSettings)
    shoot: ShootSettings = field(default_factory=ShootSettings)


def load_settings(file: Path | str) -> Settings:
    """Load settings from a TOML file; missing keys take their defaults.

    Raises
    ------
    UserError
        If the file is missing or damaged, or contains an unknown key or a value beyond its limits.
    """
    path = Path(file)
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; settings are a TOML file such as `voxel_mm = 0.2`")
    try:
        text = read_file(path).decode()
        mapping = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or integers with thousands of digits
        raise UserError(f"{path} is not valid TOML: {error}") from None
    return from_plain(Settings, mapping, Place(str(path), text))
