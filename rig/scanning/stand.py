"""What holds the camera of a scan: the arm (`rig.scanning.arm_stand`), or a tripod that a person moves."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from rhizotwin.rig.arm.placing import place_of
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.eye import Eye
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.scenes.model import Ring, Scene

FAR_MM, FAR_DEG = 40.0, 5.0
"""A person is asked again when the tripod stands further off than this."""


class Stand(Protocol):
    """Brings the camera to a ring's place."""

    failed: bool

    def refuse(self, rings: Sequence[Ring]) -> None:
        """Refuse a plan that cannot be done, before anything moves."""

    def place(self, ring: Ring) -> None:
        """Bring the camera to where a ring wants it."""

    def search(self, ring: Ring) -> tuple[Shot, Sighting | None]:
        """Take a picture and read the strip in it, looking about for it if need be."""

    def correct(self, ring: Ring, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Correct the place by what the strip shows; return what it shows at the end.

        Parameters
        ----------
        ring : Ring
            Where the camera is wanted.
        seen : Sighting or None
            What the strip shows now.
        angle_deg : callable
            Reads the table's angle back.

        Returns
        -------
        Sighting or None
            What the strip shows at the end.
        """

    def joints(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """Return the joints as commanded and as read now; None without an arm."""


class Tripod:
    """A camera that a person puts up: for the first ring before the scan, for each further ring when asked."""

    def __init__(self, scene: Scene, eye: Eye, *, ask: Ask | None, note: Callable[[str, str], None]) -> None:
        self._scene = scene
        self._eye = eye
        self._ask = ask
        self._note = note
        self.failed = False

    def refuse(self, rings: Sequence[Ring]) -> None:
        """Refuse further rings when nobody is there to move the camera."""
        if self._ask is None and any(ring != self._scene.plan.rings[0] for ring in rings):
            raise RigError(
                f"camera: the plan has {len(self._scene.plan.rings)} rings, but the rig has no arm and nobody is asked to move the camera: "
                "run it on a terminal, or scan ring by ring with --plan"
            )

    def place(self, ring: Ring) -> None:
        """Ask a person to move the camera; the first ring's place was prepared."""
        if ring == self._scene.plan.rings[0]:
            return
        if self._ask is None:
            self.refuse([ring])
            return
        self._ask(f"Move the camera: {described(ring)}. Press Enter when it stands: ")

    def search(self, ring: Ring) -> tuple[Shot, Sighting | None]:  # noqa: ARG002
        """Take a picture and read the strip in it."""
        return self._eye.look()

    def correct(self, ring: Ring, seen: Sighting | None, angle_deg: Callable[[], float]) -> Sighting | None:
        """Say where the camera stands, and ask for another try when that is far from the plan.

        Parameters
        ----------
        ring : Ring
            Where the camera is wanted.
        seen : Sighting or None
            What the strip shows now.
        angle_deg : callable
            Reads the table's angle back.

        Returns
        -------
        Sighting or None
            What the strip shows at the end.
        """
        while True:
            if seen is None:
                self._note("placed", "camera: where it stands is not known: the strip cannot be read from there")
                return None
            cam_from_rig = seen.cam_from_rig(angle_deg(), direction=self._scene.turntable.direction)
            distance_mm, height_mm, tilt_deg = place_of(cam_from_rig)
            off_mm = float(np.hypot(distance_mm - ring.distance_mm, height_mm - ring.height_mm))
            where = f"camera: stands {distance_mm:.0f} mm from the axis at z = {height_mm:.0f} mm, {tilt_deg:.1f} deg down"
            near = off_mm <= FAR_MM and abs(tilt_deg - ring.tilt_deg) <= FAR_DEG
            if near or self._ask is None:
                self._note("placed", f"{where} (asked: {described(ring)})")
                return seen
            answer = self._ask(f"{where}, but it should: {described(ring)}. Move it and press Enter, or type ok to leave it: ")
            if answer.strip().lower() == "ok":
                self._note("placed", f"{where} (asked: {described(ring)})")
                return seen
            _, seen = self._eye.look()

    def joints(self) -> tuple[None, None]:
        """Return that there is no arm."""
        return None, None


def described(ring: Ring) -> str:
    """Say where a ring wants the camera."""
    return f"{ring.distance_mm:g} mm from the axis at z = {ring.height_mm:g} mm, {ring.tilt_deg:g} deg down"
