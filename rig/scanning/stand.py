"""Stand of the camera during a scan: the arm (`rig.scanning.arm_stand`), or a tripod that the user moves."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from rhizotwin.rig.arm.placement import camera_position
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.rig.scanning.scan_camera import ScanCamera
from rhizotwin.scenes.model import Ring, Scene

FAR_MM, FAR_DEG = 40.0, 5.0
"""Position error (mm) and tilt error (deg) of a camera on a tripod, above which the user is asked to move it again."""


class Stand(Protocol):
    """Interface of a stand that places the camera at the positions of the plan's rings."""

    failed: bool

    def check_rings(self, rings: Sequence[Ring]) -> None:
        """Raise an error before any motion if the plan is impossible with this stand."""

    def place(self, ring: Ring) -> None:
        """Move the camera to the position of a ring."""

    def search(self) -> tuple[Shot, Sighting | None]:
        """Take a picture and read the strip in it, searching for the strip if necessary."""

    def correct(self, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Correct the camera's position for the placed ring, using the measured pose of the strip.

        Parameters
        ----------
        seen : Sighting or None
            Present measurement of the strip; None if the strip cannot be read.
        angle_deg : callable
            Function that returns the present table angle, deg.

        Returns
        -------
        Sighting or None
            Final measurement of the strip; None if the strip cannot be read.
        """

    def joints(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """Return the commanded and the measured joint angles, deg. Both are None if there is no arm."""


class Tripod:
    """Camera stand that the user moves.

    The camera is in position for the first ring, and the user is asked to move it for each further ring.
    """

    def __init__(self, scene: Scene, camera: ScanCamera, *, ask: Ask | None, note: Callable[[str, str], None]) -> None:
        self._scene = scene
        self._camera = camera
        self._ask = ask
        self._note = note
        self._ring = scene.plan.rings[0]
        self.failed = False

    def check_rings(self, rings: Sequence[Ring]) -> None:
        """Raise an error if the plan has several rings but there is no user to move the camera."""
        if self._ask is None and any(ring != self._scene.plan.rings[0] for ring in rings):
            raise RigError(
                f"camera: the plan has {len(self._scene.plan.rings)} rings, but the rig has no arm, and no user can be asked to move the "
                "camera; run the scan in a terminal, or scan ring by ring with --plan"
            )

    def place(self, ring: Ring) -> None:
        """Ask the user to move the camera. For the first ring it is already in position."""
        self._ring = ring
        if ring == self._scene.plan.rings[0]:
            return
        if self._ask is None:
            self.check_rings([ring])
            return
        self._ask(f"Move the camera: {describe_ring(ring)}. Press Enter when done: ")

    def search(self) -> tuple[Shot, Sighting | None]:
        """Take a picture, and read the strip in it. The measurement is None if the strip cannot be read."""
        return self._camera.look()

    def correct(self, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Report the camera's position, and ask the user to move it again if it is far from the plan.

        Parameters
        ----------
        seen : Sighting or None
            Present measurement of the strip; None if the strip cannot be read.
        angle_deg : callable
            Function that returns the present table angle, deg.

        Returns
        -------
        Sighting or None
            Final measurement of the strip; None if the strip cannot be read.
        """
        ring = self._ring
        while True:
            if seen is None:
                self._note("placed", "camera: the position is unknown, because the strip cannot be read from there")
                return None
            cam_from_rig = seen.cam_from_rig(angle_deg(), direction=self._scene.turntable.direction)
            distance_mm, height_mm, tilt_deg = camera_position(cam_from_rig)
            off_mm = float(np.hypot(distance_mm - ring.distance_mm, height_mm - ring.height_mm))
            where = f"camera: it is {distance_mm:.0f} mm from the axis, at z = {height_mm:.0f} mm, tilted down by {tilt_deg:.1f} deg"
            near = off_mm <= FAR_MM and abs(tilt_deg - ring.tilt_deg) <= FAR_DEG
            if near or self._ask is None:
                self._note("placed", f"{where} (planned: {describe_ring(ring)})")
                return seen
            answer = self._ask(
                f"{where}, but should be {describe_ring(ring)}. Move the camera and press Enter, or type ok to keep its position: "
            )
            if answer.strip().lower() == "ok":
                self._note("placed", f"{where} (planned: {describe_ring(ring)})")
                return seen
            _, seen = self._camera.look()

    def joints(self) -> tuple[None, None]:
        """Return None for the commanded and the measured joint angles, because a tripod has none."""
        return None, None


def describe_ring(ring: Ring) -> str:
    """Return a text with the camera's position and tilt for a ring."""
    return f"{ring.distance_mm:g} mm from the axis, at z = {ring.height_mm:g} mm, tilted down by {ring.tilt_deg:g} deg"
