"""Running or most recent scan of the console, with its name, its scene and its live state."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rhizotwin.console.live import Live

if TYPE_CHECKING:
    from rhizotwin.rig.scanning.observer import Look
    from rhizotwin.scenes.model import Scene


class RunningScan:
    """Scan that the console shows.

    Parameters
    ----------
    name, scene : str, Scene
        Name of the scan, and scene of the rig with the scanned plant.
    on_look, on_change, on_error : callable
        Functions that are called with each picture, after each change, and with each error of hull and display.
    paused : bool
        Pause the scan before the first picture.
    reconstruct : bool
        Whether the finished scan is reconstructed, for display.
    """

    def __init__(
        self,
        name: str,
        scene: Scene,
        *,
        on_look: Callable[[Look], object],
        on_change: Callable[[], object],
        on_error: Callable[[BaseException], object],
        paused: bool = False,
        reconstruct: bool = False,
    ) -> None:
        self.name, self.scene, self._reconstruct = name, scene, reconstruct
        self.error = ""
        """Error message if the scan has failed. It is empty if the scan has not failed."""
        self._on_change, self._on_look = on_change, on_look
        self._shown: Look | None = None
        self.live = Live(scene, on_change=self._live_changed, on_error=on_error, paused=paused)

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
            self._on_look(look)
        self._on_change()
