"""Stand of the camera during a scan: the arm (`rig.scanning.arm_stand`), or a tripod moved by the user."""

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
"""Errors of the tripod's position beyond which the user is asked to move it again."""


class Stand(Protocol):
    """Moves the camera to the position of a ring."""

    failed: bool

    def refuse(self, rings: Sequence[Ring]) -> None:
        """Raise an error for an impossible plan, before any motion."""

    def place(self, ring: Ring) -> None:
        """Move the camera to the position of a ring."""

    def search(self, ring: Ring) -> tuple[Shot, Sighting | None]:
        """Take a picture and detect the strip in it, searching for it if necessary."""

    def correct(self, ring: Ring, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Correct the camera's position by the detected strip, and return its final measurement.

        Parameters
        ----------
        ring : Ring
            Ring with the target position.
        seen : Sighting or None
            Present measurement of the strip.
        angle_deg : callable
            Function that returns the table's angle.

        Returns
        -------
        Sighting or None
            Final measurement of the strip.
        """

    def joints(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """Return the commanded and the present joint angles; None without an arm."""


class Tripod:
    """A tripod moved by the user: for the first ring before the scan, for each further ring when asked."""

    def __init__(self, scene: Scene, camera: ScanCamera, *, ask: Ask | None, note: Callable[[str, str], None]) -> None:
        self._scene = scene
        self._camera = camera
        self._ask = ask
        self._note = note
        self.failed = False

    def refuse(self, rings: Sequence[Ring]) -> None:
        """Raise an error for several rings if there is no user to move the camera."""
        if self._ask is None and any(ring != self._scene.plan.rings[0] for ring in rings):
            raise RigError(
                f"camera: the plan has {len(self._scene.plan.rings)} rings, but no arm, and there is no user to move the camera: "
                "run it in a terminal, or scan ring by ring with --plan"
            )

    def place(self, ring: Ring) -> None:
        """Ask the user to move the camera; for the first ring it is already in position."""
        if ring == self._scene.plan.rings[0]:
            return
        if self._ask is None:
            self.refuse([ring])
            return
        self._ask(f"Move the camera: {describe_ring(ring)}. Press Enter when done: ")

    def search(self, ring: Ring) -> tuple[Shot, Sighting | None]:  # noqa: ARG002
        """Take a picture and detect the strip in it."""
        return self._camera.look()

    def correct(self, ring: Ring, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Report the camera's position, and ask for another attempt if it is far from the plan.

        Parameters
        ----------
        ring : Ring
            Ring with the target position.
        seen : Sighting or None
            Present measurement of the strip.
        angle_deg : callable
            Function that returns the table's angle.

        Returns
        -------
        Sighting or None
            Final measurement of the strip.
        """
        while True:
            if seen is None:
                self._note("placed", "camera: its position is unknown: the strip cannot be read from there")
                return None
            cam_from_rig = seen.cam_from_rig(angle_deg(), direction=self._scene.turntable.direction)
            distance_mm, height_mm, tilt_deg = camera_position(cam_from_rig)
            off_mm = float(np.hypot(distance_mm - ring.distance_mm, height_mm - ring.height_mm))
            where = f"camera: is {distance_mm:.0f} mm from the axis at z = {height_mm:.0f} mm, {tilt_deg:.1f} deg down"
            near = off_mm <= FAR_MM and abs(tilt_deg - ring.tilt_deg) <= FAR_DEG
            if near or self._ask is None:
                self._note("placed", f"{where} (planned: {describe_ring(ring)})")
                return seen
            answer = self._ask(f"{where}, but planned is {describe_ring(ring)}. Move it and press Enter, or type ok to keep it: ")
            if answer.strip().lower() == "ok":
                self._note("placed", f"{where} (planned: {describe_ring(ring)})")
                return seen
            _, seen = self._camera.look()

    def joints(self) -> tuple[None, None]:
        """Return None, as there is no arm."""
        return None, None


def describe_ring(ring: Ring) -> str:
    """Return a description of the camera position of a ring."""
    return f"{ring.distance_mm:g} mm from the axis at z = {ring.height_mm:g} mm, {ring.tilt_deg:g} deg down"
