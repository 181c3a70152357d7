"""Cameras behind one interface: on this Raspberry Pi, on USB, or on another computer."""

from rhizotwin.rig.cameras.http import HttpCamera
from rhizotwin.rig.cameras.pi import PiCamera
from rhizotwin.rig.cameras.settings import CameraSettings, settings_of
from rhizotwin.rig.cameras.v4l2 import V4l2Camera
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.rig_file import CameraPart


def open_camera(part: CameraPart, *, image_wh: tuple[int, int], bits: int, clock: Clock) -> Camera:
    """Return the camera of a rig file; `Camera.prepare` opens it.

    Parameters
    ----------
    part : CameraPart
        What the rig file says of it.
    image_wh, bits : tuple of int, int
        Size and depth of the pictures, as the scene's camera has them.
    clock : Clock
        For the pauses between attempts over the network.

    Returns
    -------
    Camera
        Not open yet.

    Raises
    ------
    RigError
        When the address cannot be one of this kind, or picamera2 is missing.
    """
    settings = settings_of(part, image_wh=image_wh, bits=bits)
    if part.kind == "http":
        return HttpCamera(part.address, settings, clock=clock)
    return local_camera(part, settings)


def local_camera(part: CameraPart, settings: CameraSettings) -> Camera:
    """Return a camera that is connected to this computer."""
    return PiCamera(part.address, settings) if part.kind == "picamera2" else V4l2Camera(part.address, settings)
