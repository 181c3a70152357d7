"""Who looks on at a scan: hears what every picture shows, and may hold the scan between two pictures or end it."""

from dataclasses import dataclass

from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.rig.scanning.preflight import Exposure
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.pictures import Grey


@dataclass(frozen=True, kw_only=True)
class Look:
    """A picture of the scan and what it shows."""

    frame: Frame
    image: Grey
    """(H, W) uint8 or uint16."""
    exposure: Exposure
    sighting: Sighting | None
    """What the strip says; None where it cannot be read."""
    motion: float | None
    """Share of the picture's blocks that still changed after the stop (`rig.scanning.change`); None where it was not
    looked at."""


class Onlooker:
    """Looks on and does nothing; those who do something override what they need. Called from more than one thread."""

    watches_motion = False
    """Whether a second picture is taken at every stop and compared with the first; it costs an exposure and is not
    kept."""

    def on_plan(self, total: int, done: int) -> None:
        """Hear how many pictures the plan has, and how many of them an earlier run took."""

    def on_look(self, look: Look) -> None:
        """Hear what a picture shows, while the next one is being taken."""

    def on_drop(self, files: list[str]) -> None:
        """Hear that pictures were taken out."""

    def on_line(self, text: str) -> None:
        """Hear a line for people."""

    def holds(self) -> bool:
        """Whether the scan shall wait before its next picture; asked again and again until it may go on.

        Takes at most about a second, so that the rig is watched meanwhile. Raises `KeyboardInterrupt` to end the scan
        as Ctrl-C does.
        """
        return False
