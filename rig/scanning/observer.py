"""Observer of a scan, which receives the contents of every picture, and can pause or end the scan."""

from dataclasses import dataclass

from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.rig.scanning.preflight import Exposure
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.picture_codec import Grey


@dataclass(frozen=True, kw_only=True)
class Look:
    """A picture of the scan and the measurements on it."""

    frame: Frame
    image: Grey
    """(H, W) uint8 or uint16."""
    exposure: Exposure
    sighting: Sighting | None
    """Measurement of the strip; None if it cannot be read."""
    motion: float | None
    """Fraction of the picture's blocks that changed after the stop (`rig.scanning.picture_change`); None if it was not
    measured."""


class Observer:
    """An observer without any action; subclasses override methods, which are called from several threads."""

    watches_motion = False
    """Whether a second picture is taken at every stop and compared with the first; it costs an exposure and is not
    kept."""

    def on_plan(self, total: int, done: int) -> None:
        """Receive the number of pictures of the plan, and of those that an earlier run took."""

    def on_look(self, look: Look) -> None:
        """Receive the measurements on a picture, while the next one is being taken."""

    def on_drop(self, files: list[str]) -> None:
        """Receive the names of removed pictures."""

    def on_line(self, text: str) -> None:
        """Receive a line for the user."""

    def holds(self) -> bool:
        """Return whether the scan must wait before its next picture; called until the scan may continue.

        A call takes at most about a second, so that the rig is monitored in between. Raise `KeyboardInterrupt` to end
        the scan as Ctrl-C does.
        """
        return False
