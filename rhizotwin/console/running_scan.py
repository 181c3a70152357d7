"""Running or most recent scan of the console, with its name, its scene and its live state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rhizotwin.console.live import Live

if TYPE_CHECKING:
    from rhizotwin.rig.scanning.observer import Look
    from rhizotwin.scenes.model import Scene


@dataclass(frozen=True, kw_only=True)
class Listeners:
    """Functions that are called about a scan."""

    on_look: Callable[[Look], object]
    """Function that is called with each picture."""
    on_change: Callable[[], object]
    """Function that is called after each change."""
    on_error: Callable[[BaseException], object]
    """Function that is called with each error of hull and display."""


class RunningScan:
    """Scan that the console shows.

    Parameters
    ----------
    name, scene : str, Scene
        Name of the scan, and scene of the rig with the scanned plant.
    listeners : Listeners
        Functions that are called about the scan.
    paused : bool
        Pause the scan before the first picture.
    reconstruct : bool
        Whether the finished scan is reconstructed, for display.
    """

    def __init__(self, name: str, scene: Scene, listeners: Listeners, *, paused: bool = False, reconstruct: bool = False) -> None:
        self.name = name
        self.scene = scene
        self._reconstruct = reconstruct
        self.error = ""
        """Error message if the scan has failed. It is empty if the scan has not failed."""
        self._listeners = listeners
        self._shown: Look | None = None
        self.live = Live(scene, on_change=self._live_changed, on_error=listeners.on_error, paused=paused)

    def plain(self) -> dict[str, object]:
        """Return the state and progress of the scan as JSON values."""
        live = self.live
        state = "ended" if live.ended else "stopping" if live.stopping else "paused" if live.paused else "running"
        left_s = live.left_s()
        return {
            "name": self.name,
            "subject": str(self.scene.subject),
            "state": state,
            "done": live.done,
            "total": live.total,
            "error": self.error,
            "reconstruct": self._reconstruct,
            "left_s": None if left_s is None or state != "running" else round(left_s),
        }

    def _live_changed(self) -> None:
        look = self.live.last
        if self.live.ended:
            self._shown = None
        elif look is not None and look is not self._shown:
            self._shown = look
            self._listeners.on_look(look)
        self._listeners.on_change()
