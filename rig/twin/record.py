"""Record of the true state of the rig in each picture.

Pictures are identified by their content, so that they are also recognised in the files of a scan, and after a restart.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import Grey


@dataclass(frozen=True, kw_only=True)
class TakenShot:
    """Picture taken by the twin's camera, with the true state of the rig."""

    pixels: str
    """SHA-256 of the picture's pixels (`picture_digest`)."""
    time_s: float
    """Virtual time of the middle of the exposure, s."""
    sight: Sight


def picture_digest(image: Grey) -> str:
    """Return the SHA-256 of a picture's size, bit depth and pixels as hexadecimal text."""
    head = f"{image.shape} {image.dtype}".encode()
    return hashlib.sha256(head + np.ascontiguousarray(image).tobytes()).hexdigest()


class Record:
    """Record of all pictures that were taken.

    It is kept in memory, and after `keep_in` also in a file of JSON lines.
    """

    def __init__(self) -> None:
        self.shots: list[TakenShot] = []
        self._known: dict[str, TakenShot] = {}
        self._path: Path | None = None

    def keep_in(self, path: Path) -> None:
        """Load the record of an earlier run from a file, and append further pictures to the file.

        Raises
        ------
        UserError
            If the file cannot be read or written.
        """
        try:
            lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
            for line in lines:
                shot = _parse_line(line)
                if shot is not None:
                    self._known[shot.pixels] = shot
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a", encoding="utf-8") as file:
                file.writelines(_line(shot) for shot in self.shots)
        except OSError as error:
            raise UserError(
                f"{path}: the file cannot be used for the twin's record of pictures ({error.strerror}); choose another file"
            ) from error
        self._path = path

    def end(self) -> None:
        """Remove the file when it is no longer needed."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
            self._path = None

    def add(self, image: Grey, sight: Sight, time_s: float) -> None:
        """Add a picture to the record.

        Parameters
        ----------
        image : (H, W) uint8 or uint16 array
            Picture that the camera has stored.
        sight : Sight
            True state of the twin in the picture.
        time_s : float
            Virtual time of the middle of the exposure, s.
        """
        shot = TakenShot(pixels=picture_digest(image), time_s=time_s, sight=sight)
        self.shots.append(shot)
        self._known[shot.pixels] = shot
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(_line(shot))

    def shot_of(self, image: Grey) -> TakenShot | None:
        """Return the record of a picture.

        The result is None if the picture was not taken by this twin.
        """
        return self._known.get(picture_digest(image))


def _line(shot: TakenShot) -> str:
    sight = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in asdict(shot.sight).items()}
    return json.dumps({"pixels": shot.pixels, "time_s": shot.time_s, "sight": sight}) + "\n"


def _parse_line(line: str) -> TakenShot | None:
    """Parse a line of the file.

    Return None if the line is incomplete because the program was killed.
    """
    try:
        plain: dict[str, Any] = json.loads(line)
        sight: dict[str, Any] = {key: np.array(value) if isinstance(value, list) else value for key, value in plain["sight"].items()}
        return TakenShot(pixels=plain["pixels"], time_s=plain["time_s"], sight=Sight(**sight))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
