"""Reading of a dataset's pictures for the reconstruction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any, Literal

from rhizotwin.recon.bands import measure_bands
from rhizotwin.recon.settings import PictureSettings
from rhizotwin.scenes import transfer
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.transfer import Curve
from rhizotwin.scenes.unsupported import refuse_dark_ground, refuse_scene

LeftOut = tuple[Frame, str]
"""Excluded frame, and the reason for the exclusion."""


@dataclass(frozen=True, kw_only=True)
class CurveFound:
    """Transfer curve with which pictures are decoded, and its verification from grey values at the markers' edges."""

    curve: Curve
    """Transfer curve with which the pictures are decoded."""
    stated: Curve
    """Transfer curve stated in the picture files or in the scene."""
    bend: float | None
    """Amount by which medium grey values at the markers' edges are too bright after decoding with ``curve``, relative
    to the contrast. It is None if too few markers were measured."""
    stated_bend: float | None
    """Amount by which medium grey values at the markers' edges are too bright after decoding with ``stated``, relative
    to the contrast. It is None if too few markers were measured."""
    markers: int
    """Number of markers whose edges were measured."""

    @property
    def is_known(self) -> bool:
        """Return whether the curve in use is one of the known curves, which are the stated curve, linear and sRGB."""
        return self.curve.same(self.stated) or any(self.curve.same(known) for known in (transfer.LINEAR, transfer.SRGB))

    @property
    def warning(self) -> str | None:
        """Return a warning if the curve in use differs from the stated curve, and None if they are the same."""
        if self.curve.same(self.stated):
            return None
        off = 100.0 * (self.stated_bend or 0.0)
        return (
            f"the greys at the markers' edges do not match the stated transfer curve (gamma), {self.stated.name}: "
            f"they deviate by {off:.0f} % of the contrast. The pictures are decoded with {self.curve.name} instead."
        )


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """All usable pictures of one kind in a dataset, either of the roots or of the shoot."""

    dataset: Dataset
    """Dataset from which the pictures were read."""
    frames: tuple[Frame, ...]
    """(F,) frames of the pictures, all of one kind."""
    images: tuple[Grey, ...] = field(repr=False)
    """(F,) pictures with shape (H, W), linear in light."""
    curve: CurveFound | None = None
    """Transfer curve with which the pictures were decoded. It is None if no marker edges were measured."""
    bands: Mapping[str, float] = field(default_factory=dict)
    """Signal-to-noise ratio of each band of the camera, keyed by the band's name, with the selected band first. Empty
    if the camera has no bands, or if the band was specified in the settings."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user, for example about excluded pictures or inconsistent transfer curves."""
    left_out: tuple[LeftOut, ...] = ()
    """Frames whose pictures are excluded, each with the reason."""
    measured: Mapping[int, Any] = field(default_factory=dict, repr=False)
    """Markers found in the pictures from which the transfer curve was determined (`Markers`), keyed by the index of the
    picture."""


def read_pictures(
    dataset: Dataset,
    *,
    kind: Literal["root", "shoot"] = "root",
    settings: PictureSettings = PictureSettings(),
    monitor: Monitor,
) -> Pictures:
    """Read all pictures of the roots, or all pictures of the shoot, from a dataset.

    Parameters
    ----------
    dataset : Dataset
        Dataset with scene and frames.
    kind : {"root", "shoot"}
        Whether to read the pictures of the roots or those of the shoot.
    settings : PictureSettings
        Pictures to exclude, and the band of the root pictures. By default, the band with the largest signal-to-noise
        ratio is read.
    monitor : Monitor
        Receives progress messages.

    Raises
    ------
    UserError
        If the scene's vessel or light is not supported, or the roots are bright on dark ground; if the dataset has no
        pictures of this kind, if a picture to exclude is not in the dataset, or if a picture is
        missing or damaged and ``settings.tolerant`` is False.
    """
    refuse_scene(dataset.scene)
    given = settings.band if kind == "root" else ""
    ratios = {} if given else measure_bands(dataset, kind, monitor=monitor)
    band = given or next(iter(ratios), "")
    listed = tuple(frame for frame in dataset.frames if frame.kind == kind and frame.band == band)
    if not listed:
        taken = f" in the band {band}" if band else ""
        raise UserError(f"{dataset.folder / 'dataset.json'} lists no {kind} pictures{taken}. Take or import such pictures.")
    unwanted = _files_to_leave_out(dataset, settings.leave_out)
    if kind == "root" and not dataset.masks:
        some = [_read(dataset, frame, settings.tolerant) for frame in listed[:: max(1, len(listed) // 3)] if frame.file not in unwanted]
        refuse_dark_ground((str(dataset.folder / frame.file), image) for frame, image in some if not isinstance(image, str))
    with monitor.stage("read"):
        read = monitor.each(lambda frame: _read(dataset, frame, settings.tolerant), "read", [f for f in listed if f.file not in unwanted])
    known = [(frame, image) for frame, image in read if not isinstance(image, str)]
    left_out = [(frame, "it is named in --leave-out or in the setting pictures.leave_out") for frame in listed if frame.file in unwanted]
    left_out += [(frame, reason) for frame, reason in read if isinstance(reason, str)]
    if not known:
        raise UserError(f"{dataset.folder}: all {kind} pictures are excluded. Reason for the last picture: {left_out[-1][1]}")
    frames = tuple(frame for frame, _ in known)
    said = [f"{frame.file} is excluded: {reason}" for frame, reason in left_out]
    said += () if dataset.masks else _contradictions(dataset, frames)
    images = tuple(image for _, image in known)
    return Pictures(dataset=dataset, frames=frames, images=images, bands=ratios, warnings=tuple(said), left_out=tuple(left_out))


def _files_to_leave_out(dataset: Dataset, names: Sequence[str]) -> set[str]:
    """Return the file names of all frames that match the given names or ends of names.

    Raises
    ------
    UserError
        If a name matches no frame of the dataset.
    """
    found: set[str] = set()
    for name in names:
        end = PurePath(name).parts
        files = {frame.file for frame in dataset.frames if PurePath(frame.file).parts[-len(end) :] == end}
        if not files:
            raise UserError(f"--leave-out {name}: {dataset.folder / 'dataset.json'} lists no picture with this name")
        found |= files
    return found


def _read(dataset: Dataset, frame: Frame, tolerant: bool) -> tuple[Frame, Grey | str]:
    """Read one picture.

    If it cannot be read and ``tolerant`` is true, return the error message instead of the picture.
    """
    try:
        return frame, read_image(dataset, frame)
    except UserError as error:
        if tolerant:
            return frame, str(error)
        raise


def picture_hash(dataset: Dataset, frame: Frame) -> str:
    """Return the SHA-256 hash of a picture's file. It is computed from the file if the dataset does not state it."""
    return frame.sha256.lower() or file_sha256(dataset.folder / frame.file)


def stated_curve(dataset: Dataset, frames: Sequence[Frame]) -> Curve:
    """Return the transfer curve stated in the first picture's file.

    If the file states none, return that of the scene.
    """
    return transfer.read_stated_curve(dataset.folder / frames[0].file) or transfer.camera_curve(dataset.scene.camera)


def _contradictions(dataset: Dataset, frames: Sequence[Frame]) -> tuple[str, ...]:
    """Return a warning if the transfer curves stated in the files differ from each other or from the scene."""
    scene = transfer.camera_curve(dataset.scene.camera)
    words = [transfer.read_stated_curve(dataset.folder / frame.file) or scene for frame in frames]
    if not all(word.same(words[0]) for word in words):
        names = ", ".join(sorted({word.name for word in words}))
        return (f"the picture files state different transfer curves ({names}). Each file is decoded with its own curve.",)
    if words[0].same(scene):
        return ()
    return (
        f"the picture files state the transfer curve {words[0].name}, but the scene states {scene.name}. The curve of the files is used.",
    )
