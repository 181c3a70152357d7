"""Camera of the twin, and its driver.

The emulated sensor can stop, deliver old pictures, or use a wrong exposure. The driver must detect these faults, as for
a real camera.
"""

from collections.abc import Callable
from dataclasses import dataclass

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import NoAnswerError
from rhizotwin.rig.rig_file import CameraPart
from rhizotwin.rig.twin.faults import Pending
from rhizotwin.scenes.picture_codec import Grey

READOUT_S = 0.03
PATIENCE_S = 10.0
"""Timeout for a picture, s. The exposure time is added to it."""
TRIES = 3
NEAR = 0.01
"""Maximum relative deviation of the reported exposure time and gain from their settings."""

Look = Callable[[float], Grey]
"""Type of a function that returns a picture of the present state. The argument is the exposure relative to the nominal
exposure."""


@dataclass(frozen=True)
class _Raw:
    """Picture from the emulated sensor, with the settings that the sensor reports for it."""

    image: Grey
    began_s: float
    exposure_s: float
    gain: float


class TwinCamera:
    """Driver of the twin's camera.

    It implements `rig.devices.Camera`.

    Parameters
    ----------
    look
        Function that returns the picture of the twin for a relative exposure.
    clock
        Clock of the twin, which exposures advance.
    part
        Settings of the camera.
    nominal
        Settings with which pictures have the scene's nominal brightness.
    pending
        Faults that have not occurred yet.
    """

    def __init__(self, look: Look, clock: Clock, *, part: CameraPart, nominal: CameraPart, pending: Pending) -> None:
        self._look = look
        self._clock = clock
        self._part = part
        self._nominal = nominal
        self._pending = pending
        self._count = 0
        self._back_s = 0.0  # time at which a stopped sensor delivers pictures again
        self._last: _Raw | None = None

    def describe(self) -> str:
        """Return a description of the camera and its settings."""
        return f"the twin's camera, exposure {1000.0 * self._part.exposure_s:g} ms, gain {self._part.gain:g}"

    def prepare(self) -> None:
        """Take a picture to check that the camera works."""
        self.capture()

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call.

        Old or wrongly exposed pictures are discarded, and the capture is repeated.

        Raises
        ------
        NoAnswerError
            If no picture is received, or no picture has the required exposure.
        """
        wrong = ""
        for _ in range(TRIES):
            asked_s = self._clock.now_s()
            raw = self._frame()
            if raw.began_s < asked_s:
                wrong = "the pictures are old"
            elif not (_near(raw.exposure_s, self._part.exposure_s) and _near(raw.gain, self._part.gain)):
                wrong = f"the exposure is {1000.0 * raw.exposure_s:g} ms instead of {1000.0 * self._part.exposure_s:g} ms"
            else:
                return Shot(image=raw.image, exposure_s=raw.exposure_s, gain=raw.gain)
        raise NoAnswerError(f"camera: {wrong} ({TRIES} times in a row); reopen the camera, and check that no other program uses it")

    def close(self) -> None:
        """Do nothing, because there is nothing to release."""

    def _frame(self) -> _Raw:
        self._count += 1
        exposure_s, stale = self._part.exposure_s, False
        for fault in self._pending.due("camera", "shot", self._count, self._clock.now_s()):
            self._pending.use(fault, self._clock.now_s())
            if fault.kind == "camera_stopped":
                self._back_s = self._clock.now_s() + (fault.amount or float("inf"))
            elif fault.kind == "wrong_exposure":
                exposure_s *= fault.amount
            else:
                stale = True
        waited_s = self._back_s - self._clock.now_s()
        self._clock.sleep(min(waited_s, PATIENCE_S))
        if waited_s > PATIENCE_S:
            raise NoAnswerError(
                f"camera: no picture was received within {PATIENCE_S:g} s; check its cable and supply, then finish the scan with --resume"
            )
        if stale:
            return self._last or self._expose(exposure_s, began_s=-1.0)
        self._last = self._expose(exposure_s, began_s=self._clock.now_s())
        return self._last

    def _expose(self, exposure_s: float, *, began_s: float) -> _Raw:
        """Expose a picture, which shows the state of the twin in the middle of the exposure."""
        self._clock.sleep(exposure_s / 2.0)
        image = self._look(exposure_s * self._part.gain / (self._nominal.exposure_s * self._nominal.gain))
        self._clock.sleep(exposure_s / 2.0 + READOUT_S)
        return _Raw(image, began_s, exposure_s, self._part.gain)


def _near(value: float, wanted: float) -> bool:
    return abs(value - wanted) <= NEAR * abs(wanted)
