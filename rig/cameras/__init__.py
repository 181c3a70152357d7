"""Cameras with a common interface. They are connected to this Raspberry Pi, by USB, or to another computer."""

from rhizotwin.rig.cameras.http import HttpCamera
from rhizotwin.rig.cameras.pi import PiCamera
from rhizotwin.rig.cameras.settings import CameraSettings, combine_settings
from rhizotwin.rig.cameras.v4l2 import V4l2Camera
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.rig_file import CameraPart


def open_camera(part: CameraPart, *, image_wh: tuple[int, int], bits: int, clock: Clock) -> Camera:
    """Create the camera described in a rig file. It is opened by `Camera.prepare`.

    Parameters
    ----------
    part : CameraPart
        Section of the rig file.
    image_wh, bits : tuple of int, int
        Size and bit depth of the pictures, as in the scene's camera.
    clock : Clock
        Clock for pauses between attempts over the network.

    Returns
    -------
    Camera
        Camera, not yet open.

    Raises
    ------
    RigError
        If the address is invalid for this kind of camera, or picamera2 is missing.
    """
    settings = combine_settings(part, image_wh=image_wh, bits=bits)
    if part.kind == "http":
        return HttpCamera(part.address, settings, clock=clock)
    return local_camera(part, settings)


def local_camera(part: CameraPart, settings: CameraSettings) -> Camera:
    """Create a camera that is connected to this computer."""
    return PiCamera(part.address, settings) if part.kind == "picamera2" else V4l2Camera(part.address, settings)
