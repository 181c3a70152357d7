"""The pictures that a reconstruction begins with."""

from __future__ import annotations

from dataclasses import dataclass, field

from rhizotwin.scenes.dataset import Dataset, Frame, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.pictures import Grey


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """The pictures of the root in a dataset."""

    dataset: Dataset
    frames: tuple[Frame, ...]
    """(F,) of the root; those of the shoot are left out."""
    images: tuple[Grey, ...] = field(repr=False)
    """(F,) pictures (H, W) as stored."""


def read_pictures(dataset: Dataset, *, monitor: Monitor) -> Pictures:
    """Read a dataset's pictures of the root.

    Raises
    ------
    UserError
        Where there are none, or one is missing or damaged.
    """
    frames = tuple(frame for frame in dataset.frames if frame.kind == "root")
    if not frames:
        raise UserError(f"{dataset.folder / 'dataset.json'} lists no pictures of the root; take or import some.")
    with monitor.stage("read"):
        images = monitor.each(lambda frame: read_image(dataset, frame), "read", frames)
    return Pictures(dataset=dataset, frames=frames, images=tuple(images))
