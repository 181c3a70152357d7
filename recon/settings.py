"""What a person who studies the reconstruction may set; everything else is derived, or stands beside what it is for."""

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
    """From markers and the canister's edges to cameras."""

    worst_px: float = bounded(1.0, 0.05, 100.0)
    """A view whose reprojection error (px) is larger is left out, when it is also `worst_factor` times the median.
    Measured: 0.03 to 0.06, and with OpenCV's corners 0.1 to 0.4. A view off by a pixel takes a pixel from every root's
    width: 0.23 mm of a bench, and laterals of laterals have 0.14 to 0.28."""
    worst_factor: float = bounded(6.0, 1.0, 1000.0)
    """An error is a mean over tens of corners, so that those of views of one scan differ by tens of per cent, not by
    factors."""
    hopeless_px: float = bounded(5.0, 0.05, 1000.0)
    """A view whose reprojection error (px) is larger is left out in any case: every root loses from its width what one
    view is off, and 5 px (1.2 mm of a bench) are all of a lateral, and of a taproot up to its fifteenth day."""
    focus_sure: float = bounded(5.0, 0.0, 100.0)
    """A change of focus since the lens was calibrated is believed beyond this many standard deviations: it looks much
    like distance, and while it is free the distance is two to three times less certain
    (`docs/log/self-calibration.md`)."""
    focus_prior: float = bounded(0.005, 1e-6, 0.1)
    """Standard deviation of the focal lengths over the calibrated ones: focusing changes them by parts of a per
    cent."""
    table_prior_deg: float = bounded(0.1, 1e-4, 30.0)
    """Standard deviation of the table's angles (degrees) from the commanded ones; the pictures know them a hundred
    times better."""
    inset_prior_px: float = bounded(0.05, 1e-4, 2.0)
    """Standard deviation of how much larger on each side (px) markers may look: those of the twin were off by 0.11 in
    sRGB, by 0.002 in linear light."""
    edge_mm: float = bounded(0.1, 0.001, 5.0)
    """Scale (mm) of Cauchy's loss on the canister's edges: about a third of a pixel of a bench, and ten times the
    edges' noise."""


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """From pictures to the share of each pixel that roots cover."""

    noise_sigmas: float = bounded(4.0, 0.0, 20.0)
    """Coverage counts where its surroundings (Gaussian of a pixel) are darker by this many standard deviations of the
    empty backlight's noise: of 480 000 empty pixels 15 are so by chance."""
    dim: float = bounded(0.25, 0.0, 1.0)
    """A background darker than this share of the ring's bright one (its 90 % quantile) says nothing: flanks,
    shadows."""
    glare: float = bounded(0.05, 0.001, 1.0)
    """What is brighter than the smooth panel by this share is a reflection; where roots show that it is none of the
    panel's light it is taken off, else nothing is said there."""
    film_depth: float = bounded(0.03, 0.001, 2.0)
    """Optical depth from which a film on the wall is told: those of the profile `harsh` are found within 0.01
    (`docs/log/silhouettes-from-coverage.md`)."""
    film_most: float = bounded(0.5, 0.01, 10.0)
    """Optical depth up to which it is a film: what is darker is a thing."""
    bubble_depth: float = bounded(0.06, 0.001, 2.0)
    """Mean optical depth of a millimetre of wall with the least bubble that is told: twice the faintest film."""


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """Which pictures are used."""

    leave_out: tuple[str, ...] = ()
    """Pictures to leave out, by their files as the dataset lists them, or the ends of these names."""
    tolerant: bool = False
    """Leave out pictures that are missing or cannot be read, instead of stopping at the first."""
    band: str = ""
    """Name of the camera's band whose pictures show the roots; empty: the one with the largest signal-to-noise
    ratio."""

    def joined(self, other: PictureSettings) -> PictureSettings:
        """Return what leaves out the pictures of both, tolerant where one is."""
        return PictureSettings(
            leave_out=(*self.leave_out, *other.leave_out), tolerant=self.tolerant or other.tolerant, band=self.band or other.band
        )


@dataclass(frozen=True, kw_only=True)
class HullSettings:
    """From silhouettes to a hull."""

    finest_mm: float = bounded(0.14, 0.01, 5.0)
    """Larger voxels are carved finer than this and gathered, so that their occupancy is measured and not guessed."""
    slack_px: float = bounded(0.3, 0.01, 5.0)
    """By how much outlines are moved in and out for the silhouette-consistent bounds."""
    extrapolate_taproot: bool = False
    """Add to the volume what a taproot has behind the net pot if it goes on as it begins; the shape stays as seen."""


@dataclass(frozen=True, kw_only=True)
class TrustSettings:
    """When a volume is not trusted. Of two limits a number beyond the first is only fair, beyond the second bad."""

    widest: float = bounded(0.25, 0.0, 10.0)
    """Share of the volume that its 90 % interval may reach to one side: two scans a week apart, each this wide, tell no
    growth of a third."""
    least_views: int = bounded(8, 3, 1000)
    """Fewer views leave no view to contradict a ghost."""
    unexplained: tuple[float, float] = bounded((0.1, 0.2), 0.0, 1.0)
    """Share of the covered area that the shape leaves unexplained: beyond, the roots that were not found are too many
    to be guessed."""
    fill: tuple[float, float] = bounded((0.35, 0.5), 0.0, 1.0)
    """Share of the root zone's picture that thin roots cover: above one half no set of silhouettes tells roots from
    gaps."""
    missed: tuple[float, float] = bounded((0.05, 0.1), 0.0, 1.0)
    """Share of what the pictures show that the hull of all views leaves out: views that disagree about where things are
    carve them away. Plants and printed phantoms of the ladder have up to 0.03, right mixtures 0.06; wrong ones (24 to
    37 % of the volume lost) from 0.20 on: the limit is the geometric mean of the two
    (`docs/log/2026-11-22-mixtures.md`)."""
    sway_mm: tuple[float, float] = bounded((0.06, 0.15), 0.0, 10.0)
    """Root mean square distance (mm) of the roots in a picture from where all pictures put them. Plants of the twin
    that stand still have 0.023 to 0.059. What moves widens what all views show together by its square, and a sway of
    0.3 mm lost 10 % of the volume: these are 0.4 and 2.5 %. Cameras that are wrong have 0.48 (a cropped picture) and
    0.89 (one of half the size)."""
    dirt: tuple[float, float] = bounded((0.1, 0.35), 0.0, 1.0)
    """Share of the wall before the roots that films, bubbles and glare cover."""
    spread: tuple[float, float] = bounded((0.02, 0.04), 0.0, 1.0)
    """Share of what roots take of the light that is missing beside them (`recon.uncertainty.scattered_light`). Printed
    phantoms and plants in `clean`, `bench` and `camera` have 0.000 to 0.007; a quarter of the light scattered over 20
    px has 0.19, and made a printed phantom 5.9 % too large, so that these are 0.6 and 1.2 % of volume
    (`docs/log/2026-11-22-damages.md`)."""
    clipped: tuple[float, float] = bounded((0.002, 0.02), 0.0, 1.0)
    """Share of the panel's pixels at full scale: where the panel is clipped, what roots absorb of it is not known."""
    dim: tuple[float, float] = bounded((0.2, 0.05), 0.0, 1.0)
    """Brightness of the panel, below which: at a twentieth of full scale eight bits have 13 steps, and a root of half a
    pixel three of them."""
    wander: tuple[float, float] = bounded((0.05, 0.3), 0.0, 10.0)
    """Standard deviation of the exposure, which is divided out; by a third it moves the panel out of the camera's
    range."""
    uneven: tuple[float, float] = bounded((0.015, 0.04), 0.0, 1.0)
    """Standard deviation of the panel beside the canister over that of all pictures, which is left when the exposure
    was divided out row by row. Bands of 7 % that nobody divided out made a printed phantom 6.8 % too large: as much as
    they are (`docs/log/2026-11-22-damages.md`)."""
    blur_px: tuple[float, float] = bounded((1.2, 2.5), 0.0, 100.0)
    """Standard deviation (px) of the blur, the pixel's own 0.29 included. A root of 0.3 mm is a pixel wide at 800
    pixels across 250 mm; blurred by 2.5 px it darkens the panel by a sixth."""
    refocus_px: tuple[float, float] = bounded((0.5, 1.0), 0.0, 100.0)
    """By how much (px) the least sharp picture is blurred more than the sharpest, as standard deviations add up. All
    are fitted with one blur: half of a printed phantom's pictures blurred by 1.5 px more lost 9.3 % of it, which grows
    with the square, so that 1 px is 4 % and 0.5 px 1 %. Plants and printed phantoms in `bench`, `camera` and mixtures
    have 0.1."""
    inset_px: tuple[float, float] = bounded((0.03, 0.045), 0.0, 10.0)
    """How much larger on each side (px) the markers look: their blurred edges stay where they are in light. Right scans
    of the twin have 0.001 to 0.005, an uncalibrated lens of k1 = -0.15, right to 1.1 %, 0.028; a table that turns by
    4 px meanwhile has 0.077 and 6.9 % too much, sRGB taken for light 0.11. The second is the geometric mean of the
    largest right one and the least wrong one."""
    corners_px: tuple[float, float] = bounded((0.3, 1.0), 0.0, 100.0)
    """How far (px) the markers' corners lie from where the cameras put them; fitted ones are within 0.06, OpenCV's own
    within 0.2 at 800 pixels and 0.4 at 400 (measured)."""
    radius_share: tuple[float, float] = bounded((0.002, 0.006), 0.0, 1.0)
    """Outer radius of the canister over the drawing's, less one, that is left after it was corrected: a lens as strong
    by so much less."""
    edge_mm: tuple[float, float] = bounded((0.06, 0.15), 0.0, 10.0)
    """The canister's edges about an oval (mm, median)."""
    oval_mm: tuple[float, float] = bounded((0.12, 0.3), 0.0, 10.0)
    """Half the difference between the canister's radii (mm). A wall that leans by 2 e / R bends a ray by a quarter of
    that (index 1.33), which moves a root on the axis by e / 2: as much as ``sway_mm`` allows roots to move."""
    resolution_px: tuple[float, float] = bounded((0.7, 0.0), 0.0, 100.0)
    """Width of thin roots in the pictures (px), below which. The views of a radish of five days disagree at 0.61, not
    at 0.75 and 0.95; the first is the geometric mean. It is bad by itself at no width: where views agree all the same,
    the volume is right."""
    left_out: tuple[float, float] = bounded((0.1, 0.34), 0.0, 1.0)
    """Share of the pictures that could not be used."""
    gap_deg: tuple[float, float] = bounded((30.0, 75.0), 0.0, 360.0)
    """Largest step (degrees) between neighbouring views round the canister: what no view looks along is bounded by the
    two beside it."""

    def __post_init__(self) -> None:
        """Refuse limits in the wrong order; only the panel's brightness and the width of roots are bad where small."""
        for each in fields(self):
            value = getattr(self, each.name)
            is_small_bad = each.name in ("dim", "resolution_px")
            if isinstance(value, tuple) and (value[0] < value[1] if is_small_bad else value[0] > value[1]):
                side = "above" if is_small_bad else "below"
                raise UserError(f"[trust] {each.name} = {list(value)}: the second limit must not be {side} the first")


@dataclass(frozen=True, kw_only=True)
class ShootSettings:
    """What grows above the net pot."""

    leaf_thickness_mm: float = bounded(0.0, 0.0, 10.0)
    """Thickness of a blade (mm), as a caliper or the mass of a punched disc tells it; 0: nobody measured it, and the
    shoot's volume is not told. Blades are as thick as a pixel is wide (0.3 mm), which silhouettes do not resolve."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a reconstruction, a group for each stage."""

    voxel_mm: float = bounded(0.27, 0.01, 20.0)
    """Edge of the voxels that are written (0.27: the thesis's); measuring inside them is finer."""
    pictures: PictureSettings = field(default_factory=PictureSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    coverage: CoverageSettings = field(default_factory=CoverageSettings)
    hull: HullSettings = field(default_factory=HullSettings)
    trust: TrustSettings = field(default_factory=TrustSettings)
    shoot: ShootSettings = field(default_factory=ShootSettings)


def load_settings(file: Path | str) -> Settings:
    """Load settings from a TOML file; what it leaves out has its default.

    Raises
    ------
    UserError
        Where the file is missing or damaged, or holds an unknown key or a value beyond its limits.
    """
    path = Path(file)
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; give the settings as TOML, such as `voxel_mm = 0.2`")
    try:
        text = read_file(path).decode()
        mapping = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # no UTF-8, no TOML, or integers of thousands of digits
        raise UserError(f"{path} is not readable TOML: {error}") from None
    return from_plain(Settings, mapping, Place(str(path), text))
