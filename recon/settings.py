"""User settings of the reconstruction.

All other parameters are derived from data, or are constants in the modules that use them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Settings for the calibration of the cameras from the markers and the canister's edges."""

    worst_px: float = bounded(1.0, 0.05, 100.0)
    """Reprojection error above which a view is excluded, px, if the error also exceeds `worst_factor` times the median
    of all views. Typical errors are 0.03 to 0.06 px, or 0.1 to 0.4 px with OpenCV's corners. An error of one pixel in
    one view reduces the width of every root by one pixel. On a bench, this is 0.23 mm, whereas second-order laterals
    are 0.14 to 0.28 mm wide."""
    worst_factor: float = bounded(6.0, 1.0, 1000.0)
    """Ratio of a view's reprojection error to the median of all views above which the view is excluded, if the error
    also exceeds `worst_px`. Reprojection errors are means over tens of corners, so they differ between the views of one
    scan by tens of per cent, not by factors."""
    hopeless_px: float = bounded(5.0, 0.05, 1000.0)
    """Reprojection error above which a view is always excluded, px. The error of one view reduces the width of every
    root by the same amount. An error of 5 px (1.2 mm on a bench) exceeds the width of any lateral, and of a taproot up
    to its fifteenth day."""
    focus_sure: float = bounded(5.0, 0.0, 100.0)
    """Minimum estimated change of the focal length, in standard deviations, at which the estimate replaces the
    calibrated focal length. A change of focus resembles a change of distance: the uncertainty of the distance increases
    two to three times while the focus is estimated (`docs/log/self-calibration.md`)."""
    focus_prior: float = bounded(0.005, 1e-6, 0.1)
    """Prior standard deviation of the ratio of the focal lengths to their calibrated values. Focusing changes focal
    lengths by fractions of a per cent."""
    table_prior_deg: float = bounded(0.1, 1e-4, 30.0)
    """Prior standard deviation of the table angles about the commanded angles, degrees. The pictures determine the
    table angles a hundred times more precisely."""
    inset_prior_px: float = bounded(0.05, 1e-4, 2.0)
    """Prior standard deviation of the apparent enlargement of the markers on each side, px. In the twin, the
    enlargement is 0.11 px for sRGB pictures and 0.002 px for pictures linear in light."""
    edge_mm: float = bounded(0.1, 0.001, 5.0)
    """Scale of the Cauchy loss for the residuals of the canister's edges, mm. The default is about a third of a pixel
    on a bench, and ten times the noise of the edges."""


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """Settings for the measurement of the coverage of each pixel by roots."""

    noise_sigmas: float = bounded(4.0, 0.0, 20.0)
    """Minimum darkening that counts as coverage, in standard deviations of the noise of the empty backlight. The
    picture is first smoothed by a Gaussian of one pixel. With the default, 15 of 480 000 empty pixels count as covered
    by chance."""
    dim: float = bounded(0.25, 0.0, 1.0)
    """Minimum brightness of the background at a usable pixel. It is relative to the 90 % quantile of the background's
    brightness over the water in the same picture. Darker pixels occur at the canister's flanks and in shadows."""
    glare: float = bounded(0.05, 0.001, 1.0)
    """Brightness in excess of the smoothed panel, as a fraction of the panel's brightness, above which a pixel is
    classified as a reflection. If roots in front of the panel show the same excess, it is light that the wall reflects,
    and it is subtracted. Otherwise, the pixels are not usable."""
    film_depth: float = bounded(0.03, 0.001, 2.0)
    """Minimum optical depth of films that are detected on the wall. Optical depths of films in the profile `harsh` are
    measured to within 0.01 (`docs/log/silhouettes-from-coverage.md`)."""
    film_most: float = bounded(0.5, 0.01, 10.0)
    """Maximum optical depth of a film on the wall. Darker structures are treated as objects."""
    bubble_depth: float = bounded(0.06, 0.001, 2.0)
    """Minimum optical depth of a bubble, averaged over one millimetre of wall. The default is twice the optical depth
    of the faintest film."""


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """Settings for the selection of pictures and of the camera band."""

    leave_out: tuple[str, ...] = ()
    """Pictures to exclude, specified by their file names in the dataset or by the ends of these names."""
    tolerant: bool = False
    """Whether pictures that are missing or cannot be read are excluded. By default, such pictures stop the
    reconstruction with an error."""
    hold_out: int = bounded(0, 0, 1000)
    """Number n, so that every n-th picture is held out for `rhizotwin verify`; 0 to use all pictures. The markers in
    these pictures are used for the calibration of the cameras, but their roots are not used."""
    band: str = ""
    """Name of the camera band used for the roots. By default, the band with the largest signal-to-noise ratio is used.
    """

    def joined(self, other: PictureSettings) -> PictureSettings:
        """Combine these settings with other settings.

        A picture is excluded if either of them excludes it, and unreadable pictures are tolerated if either tolerates
        them. The band of these settings and their ``hold_out`` take precedence.
        """
        return PictureSettings(
            leave_out=(*self.leave_out, *other.leave_out),
            tolerant=self.tolerant or other.tolerant,
            hold_out=self.hold_out or other.hold_out,
            band=self.band or other.band,
        )


@dataclass(frozen=True, kw_only=True)
class HullSettings:
    """Settings for the carving of the visual hull from the silhouettes."""

    finest_mm: float = bounded(0.15, 0.01, 5.0)
    """Maximum edge length of carved voxels, mm. Larger output voxels are assembled from carved voxels, so that their
    occupancy is measured."""
    slack_px: float = bounded(0.3, 0.01, 5.0)
    """Displacement of all outlines, inwards and outwards, from which the smallest and largest volume consistent with
    the silhouettes are computed, px."""
    extrapolate_taproot: bool = False
    """Whether the volume of the taproot behind the net pot is added. The hidden volume is extrapolated from the visible
    part of the taproot. The shape does not change."""


@dataclass(frozen=True, kw_only=True)
class TrustSettings:
    """Limits that a scan must satisfy for its volume to be trusted.

    A setting with two values has a fair and a bad limit. A measured value beyond the fair limit is rated fair, and a
    value beyond the bad limit is rated bad.
    """

    widest: float = bounded(0.25, 0.0, 10.0)
    """Maximum half-width of the 90 % interval of a trusted volume, relative to the volume. With this half-width, two
    scans one week apart do not resolve growth by a third."""
    least_views: int = bounded(8, 3, 1000)
    """Minimum number of views of a trusted volume. With fewer views, there may be no view that contradicts a ghost,
    which is a reconstructed root without a real one."""
    unexplained: tuple[float, float] = bounded((0.1, 0.2), 0.0, 1.0)
    """Fair and bad limits for the fraction of the covered area that the shape does not explain. Above the bad limit,
    too many roots were missed to estimate their volume."""
    fill: tuple[float, float] = bounded((0.35, 0.5), 0.0, 1.0)
    """Fair and bad limits for the fraction of the root zone that thin roots cover in the pictures. Above one half,
    silhouettes no longer distinguish roots from gaps."""
    missed: tuple[float, float] = bounded((0.05, 0.3), 0.0, 1.0)
    """Fair and bad limits for the fraction of the coverage that lies outside the visual hull of all views. If the
    geometry of the views is inconsistent, carving removes roots. The fraction is at most 0.03 for simulated plants and
    printed phantoms. Between 0.1 and 0.3, correct and wrong volumes occur alike, and the intervals have a calibration
    of their own (`recon.uncertainty.calibration`). Above 0.3, more than a third of the volume was lost in most random
    scans (`docs/intervals.md`)."""
    sway_mm: tuple[float, float] = bounded((0.06, 0.15), 0.0, 10.0)
    """Fair and bad limits for the root mean square displacement of the roots in single pictures from their common
    position, mm. The displacement is 0.023 to 0.059 mm for static plants in the twin. The volume lost by motion grows
    with the square of the displacement, and a sway of 0.3 mm lost 10 % of the volume. The limits therefore correspond
    to 0.4 and 2.5 %. Scans with wrong cameras have 0.48 mm (a cropped picture) and 0.89 mm (a picture of half the
    size)."""
    dirt: tuple[float, float] = bounded((0.1, 0.35), 0.0, 1.0)
    """Fair and bad limits for the fraction of the wall in front of the roots that films, bubbles and glare cover."""
    clipped: tuple[float, float] = bounded((0.002, 0.02), 0.0, 1.0)
    """Fair and bad limits for the fraction of the panel's pixels at full scale. Where the panel is clipped, the
    absorption by roots is unknown."""
    dim: tuple[float, float] = bounded((0.2, 0.05), 0.0, 1.0)
    """Fair and bad lower limits for the brightness of the panel, relative to full scale. At a twentieth of full scale,
    an 8-bit picture resolves 13 levels, and a root half a pixel wide spans three of these levels."""
    wander: tuple[float, float] = bounded((0.05, 0.3), 0.0, 10.0)
    """Fair and bad limits for the standard deviation of the exposure between the pictures. The exposure is normalised,
    but if it varies by a third, the brightness of the panel exceeds the camera's range."""
    uneven: tuple[float, float] = bounded((0.015, 0.04), 0.0, 1.0)
    """Fair and bad limits for the variation in brightness of the panel beside the canister after the exposure has been
    normalised row by row. The variation is the standard deviation between parts of the panel, relative to the median of
    all pictures from the same camera position. Without the normalisation, brightness bands of 7 % made a printed
    phantom 6.8 % too large: the relative error of the volume is about that of the brightness
    (`docs/log/reliability.md`)."""
    blur_px: tuple[float, float] = bounded((1.2, 2.5), 0.0, 100.0)
    """Fair and bad limits for the standard deviation of the blur, px, including 0.29 px of the pixel itself. At 800
    pixels across 250 mm, a root of 0.3 mm is one pixel wide. Blurred by 2.5 px, the root darkens the panel by a sixth.
    """
    refocus_px: tuple[float, float] = bounded((0.5, 1.0), 0.0, 100.0)
    """Fair and bad limits for the difference in blur between the least sharp and the sharpest picture, px. It is the
    square root of the difference of the two variances. All pictures are fitted with the same blur. When half of a
    printed phantom's pictures were blurred by an additional 1.5 px, 9.3 % of its volume was lost. The loss grows with
    the square of the blur, so the limits correspond to 1 % and 4 %. The additional blur is 0.1 px for simulated plants
    and printed phantoms."""
    inset_px: tuple[float, float] = bounded((0.03, 0.045), 0.0, 10.0)
    """Fair and bad limits for the apparent enlargement of the markers on each side, px. In linear light, blur does not
    move the markers' edges. The enlargement is 0.001 to 0.005 px for correct scans of the twin, and 0.028 px for an
    uncalibrated lens with k1 = -0.15, whose volume was correct to 1.1 %. It is 0.077 px for a table that turns by 4 px
    during the exposure, with a volume 6.9 % too large, and 0.11 px for sRGB values interpreted as light. The bad limit
    is the geometric mean of the largest value of an acceptable scan and the smallest value of a wrong scan."""
    corners_px: tuple[float, float] = bounded((0.3, 1.0), 0.0, 100.0)
    """Fair and bad limits for the distance of the markers' corners from their projections by the estimated cameras, px.
    The measured distance is at most 0.06 px for fitted corners. For OpenCV's corners, the distance is at most 0.2 px in
    pictures 800 pixels wide, and 0.4 px in pictures 400 pixels wide."""
    radius_share: tuple[float, float] = bounded((0.002, 0.006), 0.0, 1.0)
    """Fair and bad limits for the difference between the canister's fitted outer radius and its nominal value, as a
    fraction of the nominal value. The refractive power of the canister changes by the same fraction."""
    edge_mm: tuple[float, float] = bounded((0.06, 0.15), 0.0, 10.0)
    """Fair and bad limits for the median deviation of the canister's edges from the fitted oval, mm."""
    oval_mm: tuple[float, float] = bounded((0.12, 0.3), 0.0, 10.0)
    """Fair and bad limits for half the difference e between the largest and the smallest outer radius of the canister,
    mm. A wall inclined by 2 e / R deflects a ray by a quarter of this angle (index 1.33), which displaces a root on the
    axis by e / 2. The limits permit the same displacement as ``sway_mm``."""
    resolution_px: tuple[float, float] = bounded((0.7, 0.0), 0.0, 100.0)
    """Fair and bad lower limits for the width of thin roots in the pictures, px. The views of a five-day-old radish are
    inconsistent at a width of 0.61 px, but consistent at 0.75 and 0.95 px. The fair limit is the geometric mean of 0.61
    and 0.75. The bad limit is zero, because the volume is correct at any width if the views are consistent."""
    left_out: tuple[float, float] = bounded((0.1, 0.34), 0.0, 1.0)
    """Fair and bad limits for the fraction of the pictures that could not be used."""
    gap_deg: tuple[float, float] = bounded((30.0, 75.0), 0.0, 360.0)
    """Fair and bad limits for the largest angular step between neighbouring views around the canister, degrees. Between
    two neighbouring views, the shape is constrained only by these views."""

    def __post_init__(self) -> None:
        """Check the order of the two limits of each setting.

        The bad limit must not be the smaller one, except for the brightness of the panel and the width of roots, where
        it must not be the larger one.
        """
        for each in fields(self):
            value = getattr(self, each.name)
            is_small_bad = each.name in ("dim", "resolution_px")
            if isinstance(value, tuple) and (value[0] < value[1] if is_small_bad else value[0] > value[1]):
                side = "above" if is_small_bad else "below"
                raise UserError(f"[trust] {each.name} = {list(value)}: the second limit must not be {side} the first")


@dataclass(frozen=True, kw_only=True)
class ShootSettings:
    """Settings for the measurement of the shoot."""

    leaf_thickness_mm: float = bounded(0.0, 0.0, 10.0)
    """Thickness of a leaf blade, mm, measured with a calliper or from the mass of a punched disc. Set 0 if the
    thickness is unknown, in which case the volume of the shoot is not computed. Blades are about one pixel thick (0.3
    mm), which silhouettes do not resolve."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a reconstruction, in one group per stage."""

    voxel_mm: float = bounded(0.27, 0.01, 20.0)
    """Edge length of the output voxels, mm. The default of 0.27 mm is the value used in the thesis. Volumes are
    measured on a finer grid."""
    pictures: PictureSettings = field(default_factory=PictureSettings)
    """Settings for the selection of pictures."""
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    """Settings for the calibration of the cameras."""
    coverage: CoverageSettings = field(default_factory=CoverageSettings)
    """Settings for the measurement of coverage."""
    hull: HullSettings = field(default_factory=HullSettings)
    """Settings for the carving of the visual hull."""
    trust: TrustSettings = field(default_factory=TrustSettings)
    """Limits that a scan must satisfy for its volume to be trusted."""
    shoot: ShootSettings = field(default_factory=ShootSettings)
    """Settings for the measurement of the shoot."""


def load_settings(file: Path | str) -> Settings:
    """Load settings from a TOML file; keys that are missing from the file keep their default values.

    Raises
    ------
    UserError
        If the file is missing or is not valid TOML, or contains an unknown key or a value outside its limits.
    """
    table, text = read_toml(Path(file))
    return from_plain(Settings, table, Place(str(file), text))
