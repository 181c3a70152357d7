"""Pictures of one view of a scan, in every band of the camera.

Before each picture the lamps and the filter are set for its band. After it, the table angle and the brightness of the
panel are verified.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

from rhizotwin.rig import bands
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning.preflight import measure_exposure
from rhizotwin.rig.scanning.scan_camera import ScanCamera
from rhizotwin.rig.scanning.scan_log import ScanLog
from rhizotwin.rig.scanning.scan_turntable import ScanTurntable
from rhizotwin.rig.scanning.session import picture_file
from rhizotwin.rig.scanning.stand import Stand
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.plan import View

DIMMER, BRIGHTER = 0.6, 1.6
"""Minimum and maximum ratio of the panel's brightness to its brightness in the first picture of the ring. Outside this
range, the lights are failing."""

Picture: TypeAlias = tuple[Frame, Grey]


class ViewPictures:
    """Takes the pictures of each view of a scan, in all bands of the camera."""

    def __init__(
        self,
        devices: Devices,
        camera: ScanCamera,
        turntable: ScanTurntable,
        stand: Stand,
        log: ScanLog,
    ) -> None:
        self._devices = devices
        self._camera = camera
        self._turntable = turntable
        self._stand = stand
        self._log = log
        self._main, self._others = "", tuple[str, ...]()
        """Name of the band in which the markers are visible in this ring, and names of its other bands."""
        self._selected: str | None = ""
        """Name of the band to which the lamps and the filter are set. It is None after a fault."""
        self.placement = 0
        """Number of the camera's placement in this ring, which is stored in the frames."""
        self.rest_s = devices.rig.turntable.settle_s
        """Pause between a turn of the table and the picture, s."""
        self.bright = 0.0
        """Brightness of the panel in the ring's first picture, as a fraction of full scale."""

    def begin_ring(self, main: str, others: Sequence[str]) -> None:
        """Set lamps and filter for a ring.

        Parameters
        ----------
        main : str
            Name of the band in which the markers are visible. It is set now, and taken first in every view.
        others : sequence of str
            Names of the other bands of the ring, in the order in which they are taken.
        """
        self._main, self._others = main, tuple(others)
        self._select(main)

    def reset_band(self) -> None:
        """Return to the band of the markers after a fault of the board, regardless of the band in which it failed.

        The filter is set now, and the lamps when the board is recovered.
        """
        self._turntable.band, self._selected = self._main, None
        bands.turn_filter(self._devices.arm, self._devices.rig, self._main)

    def take(self, view: View, *, twice: bool) -> tuple[Picture, list[Picture], Grey | None]:
        """Rotate the table, wait, take the picture, and verify that the table has not moved.

        The same view is then taken in all other bands.

        Parameters
        ----------
        view : View
            View with its table angle.
        twice : bool
            Whether to take a second picture in the band of the markers, from which motion is measured.

        Returns
        -------
        Picture, list of Picture, (H, W) uint8 or uint16 array or None
            Frame and picture in the band of the markers; those in the other bands; second picture, or None.

        Raises
        ------
        BoardFaultError
            If the board of the table and the lights fails. The view can be taken again after its recovery.
        RigError
            If another device fails, or the panel has become darker or brighter.
        """
        main, clock = self._main, self._devices.clock
        self._select(main)
        read_deg = self._turntable.turn(view.table_deg)
        moved_s = clock.now_s()
        joints_deg, joints_read_deg = self._stand.joints()  # while the water comes to rest
        clock.sleep(self.rest_s - (clock.now_s() - moved_s))
        shot = self._lit_picture(view.table_deg)
        frame = Frame(
            file=picture_file(view, main),
            sha256="",
            kind=view.kind,
            band=main,
            view=view.index if main else None,
            ring=view.ring,
            table_deg=view.table_deg,
            table_read_deg=read_deg,
            placement=self.placement,
            joints_deg=joints_deg,
            joints_read_deg=joints_read_deg,
            exposure_s=shot.exposure_s,
            gain=shot.gain,
            time_s=round(self._log.now_s(), 6),
        )
        again = self._camera.picture(table_deg=view.table_deg, band=main).image if twice else None
        return (frame, shot.image), self._other_bands(view, frame), again

    def _other_bands(self, view: View, frame: Frame) -> list[Picture]:
        """Take the same view in all other bands of the camera, and restore the first band."""
        taken: list[Picture] = []
        for band in self._others:
            self._select(band)
            shot = self._camera.picture(table_deg=view.table_deg, band=band)
            self._turntable.verify(view.table_deg)
            now_s = round(self._log.now_s(), 6)
            own = replace(frame, file=picture_file(view, band), band=band, exposure_s=shot.exposure_s, gain=shot.gain, time_s=now_s)
            taken.append((own, shot.image))
        self._select(frame.band)
        return taken

    def _lit_picture(self, angle_deg: float) -> Shot:
        """Take a picture, and verify that the table is at rest and the brightness of the panel is unchanged.

        The picture is the only evidence, because the state of the lamps cannot be read back.
        """
        bright = 0.0
        for again in (False, True):
            if again:
                self._log.note(
                    "lights",
                    f"lights: the brightness of the panel changed from {self.bright:.2f} to {bright:.2f} of full scale; the lamps are "
                    "switched on again",
                )
                self._turntable.light()
            shot = self._camera.picture(table_deg=angle_deg, band=self._main)
            self._turntable.verify(angle_deg)
            bright = measure_exposure(shot.image).bright
            if DIMMER * self.bright <= bright <= BRIGHTER * self.bright:
                return shot
        raise RigError(
            f"lights: the panel is at {100.0 * bright:.0f} % of full scale, but was at {100.0 * self.bright:.0f} %; check the lamps, "
            "their supply and that nothing hides the panel, then finish the scan with --resume"
        )

    def _select(self, band: str) -> None:
        """Set lamps and filter for a band of the camera, unless they are already set."""
        if band == self._selected:
            return
        self._selected = None
        self._turntable.light(band)
        bands.turn_filter(self._devices.arm, self._devices.rig, band)
        self._selected = band
