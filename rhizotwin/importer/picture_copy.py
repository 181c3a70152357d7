"""Copies of pictures in a dataset, with checks for damage and overexposure."""

from pathlib import Path
from typing import TypeAlias

from rhizotwin.importer import raw_pictures
from rhizotwin.importer.damaged_rows import DamageCheck
from rhizotwin.importer.given_cameras import GivenCameras
from rhizotwin.importer.given_lens import Lens
from rhizotwin.importer.picture_files import read_picture
from rhizotwin.importer.resampling import Resampler
from rhizotwin.importer.silhouettes import Levels, encode_silhouette
from rhizotwin.rig.scanning.preflight import MOST_SATURATED
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.dataset import Frame, file_sha256
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.orientation import read_orientation
from rhizotwin.scenes.picture_codec import Grey, decode_light, encode_light_png, encode_png, is_sealed
from rhizotwin.scenes.transfer import LINEAR, camera_curve, read_stated_curve

Placed: TypeAlias = tuple[int, str, int, float | None]
"""View, band, ring and table angle (deg, or None if it is unknown) of a picture."""


class PictureCopier:
    """Copies pictures to a dataset and collects notes about them.

    Parameters
    ----------
    scene : Scene
        Scene whose camera has the size of the pictures.
    folder : Path
        Dataset folder.
    raw : bool
        Whether the pictures are raw pictures.
    levels : dict of Path to Levels, or None
        Levels of each silhouette; None for photographs.
    given : GivenCameras or None
        Cameras from a file; None if they are estimated from the markers.
    """

    def __init__(self, scene: Scene, folder: Path, *, raw: bool, levels: dict[Path, Levels] | None, given: GivenCameras | None) -> None:
        self._scene, self._folder = scene, folder
        self._raw, self._levels, self._given = raw, levels, given
        self._picture_wh = scene.camera.image_wh if given is None else given.picture_wh
        self._resampler = Resampler(given.camera) if given is not None and given.is_resampled else None
        self._gains: tuple[float, float] | None = None
        self._damage = DamageCheck()
        self._count = 0
        self.clipped: dict[str, float] = {}
        """Fraction of saturated pixels in each overexposed picture, keyed by file name."""

    def copy(self, paths: list[Path], table: list[Placed], monitor: Monitor) -> tuple[Frame, ...]:
        """Copy all pictures to the dataset.

        Photographs are stored unchanged, and all other pictures and those with another lens as PNG.

        Parameters
        ----------
        paths : list of Path
            Picture files.
        table : list of Placed
            View, band, ring and table angle of each picture.
        monitor : Monitor
            Receiver of the progress.

        Returns
        -------
        tuple of Frame
            Frames of the pictures, in the same order.

        Raises
        ------
        UserError
            If a picture is unreadable, damaged or of another size, or is not a silhouette although it should be.
        """
        found = []
        with monitor.stage("copy"), monitor.steps("copy", len(paths), "picture") as step:
            for path, placed in zip(paths, table, strict=True):
                found.append(self._copy_picture(path, placed))
                step()
        self._damage.refuse_damaged()
        self._count = len(found)
        return tuple(found)

    def _copy_picture(self, path: Path, placed: Placed) -> Frame:
        """Write one picture to the dataset, and check its exposure."""
        view, band, ring, table_deg = placed
        if self._raw:
            grey, self._gains = raw_pictures.read_raw(path, image_wh=self._picture_wh, gains=self._gains)
            data = encode_light_png(grey)
        else:
            data, grey = read_picture(path, image_wh=self._picture_wh)
            if self._levels is not None:
                data = encode_silhouette(grey, self._levels[path])
        sealed = self._raw or is_sealed(data)
        orientation = read_orientation(data)
        given = None if self._given is None else self._given.of(path)
        if self._resampler is not None and given is not None:
            data = self._resample(path, grey if self._raw else data, self._resampler, given.lens)
        kept = not self._raw and self._levels is None and self._resampler is None
        name = f"images/{path.stem}{path.suffix.lower() if kept else '.png'}"
        write_bytes(self._folder / name, data)
        if self._levels is None:
            self._damage.add(path, (ring, band), grey, sealed=sealed, orientation=orientation)
            if (share := _clipped(grey)) > MOST_SATURATED:
                self.clipped[name] = round(share, 4)
        return Frame(
            file=name,
            sha256=file_sha256(self._folder / name),
            kind=self._scene.plan.rings[ring].kind,
            band=band,
            view=view if band else None,
            ring=ring,
            table_deg=table_deg,
            cam_from_canister=None if given is None else tuple(tuple(row) for row in given.cam_from_canister.tolist()),
        )

    def _resample(self, path: Path, picture: bytes | Grey, resampler: Resampler, lens: Lens) -> bytes:
        """Return a picture as PNG, resampled from its own lens to that of the dataset, and linear in light."""
        masks = self._levels is not None
        if isinstance(picture, bytes):
            curve = LINEAR if masks else read_stated_curve(picture) or camera_curve(self._scene.camera)
            picture = decode_light(picture, curve, where=str(path))
        resampled = resampler.resample(picture, lens, masks=masks)
        return encode_png(resampled) if masks else encode_light_png(resampled)

    def notes(self) -> list[str]:
        """Return notes about overexposed pictures and about pictures that could not be checked for damage."""
        if not self.clipped:
            return self._damage.notes()
        worst = max(self.clipped, key=lambda name: self.clipped[name])
        return [
            *self._damage.notes(),
            f"warning: {len(self.clipped)} of {self._count} pictures are overexposed; the worst is {worst} with "
            f"{100.0 * self.clipped[worst]:.0f} % of its pixels at full scale, where the light absorbed by roots cannot be measured. "
            "Reduce the exposure so that the panel is at 80 % of full scale",
        ]


def _clipped(grey: Grey) -> float:
    """Return the fraction of saturated pixels in a picture.

    The bit depth of the picture may be smaller than that of the file, such as 12 bits in a 16-bit file.
    """
    largest = int(grey.max())
    # full scale of 8, 10, 12, 14 and 16 bits, and of 10, 12 and 14 bits shifted to 16 bits
    full = {255, 1023, 4095, 16383, 65535, 65472, 65520, 65532}
    return float((grey == largest).mean()) if largest in full else 0.0
