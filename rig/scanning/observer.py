"""Observer of a scan, which is notified of every picture and can pause or end the scan."""

from dataclasses import dataclass

from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.rig.scanning.preflight import Exposure
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.picture_codec import Grey


@dataclass(frozen=True, kw_only=True)
class Look:
    """Picture of a scan, with the measurements made on it."""

    frame: Frame
    image: Grey
    """Picture as (H, W) uint8 or uint16 array."""
    exposure: Exposure
    sighting: Sighting | None
    """Measurement of the strip. It is None if the strip cannot be read."""
    motion: float | None
    """Fraction of the picture's blocks that changed after the table had stopped (`rig.scanning.picture_change`). It is
    None if it was not measured."""


class Observer:
    """Observer that does nothing. Subclasses override its methods, which are called from several threads."""

    watches_motion = False
    """Whether a second picture is taken at every stop of the table, to detect motion by comparison with the first
    picture. It requires the time of an exposure and is not stored."""

    def on_plan(self, total: int, done: int) -> None:
        """Receive the number of pictures in the plan, and the number of pictures taken in earlier runs."""

    def on_look(self, look: Look) -> None:
        """Receive a picture and its measurements, while the next picture is being taken."""

    def on_drop(self, files: list[str]) -> None:
        """Receive the names of picture files that were removed."""

    def on_line(self, text: str) -> None:
        """Receive a message for the user."""

    def holds(self) -> bool:
        """Return whether the scan must wait before its next picture. The scan calls this method until it returns False.

        A call should take at most about a second, so that the rig is monitored in between. Raise `KeyboardInterrupt` to
        end the scan in the same way as Ctrl-C.
        """
        return False
