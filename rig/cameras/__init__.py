"""Cameras with a common interface. They are connected to this Raspberry Pi, by USB, or to another computer."""

from rhizotwin.rig.cameras.gphoto import GphotoCamera
from rhizotwin.rig.cameras.http import HttpCamera
from rhizotwin.rig.cameras.pi import PiCamera
from rhizotwin.rig.cameras.settings import CameraSettings, combine_settings
from rhizotwin.rig.cameras.v4l2 import V4l2Camera
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.rig_file import CameraPart


def open_camera(part: CameraPart, *, image_wh: tuple[int, int], bits: int, clock: Clock, linear: bool = True) -> Camera:
    """Create the camera described in a rig file. It is opened by `Camera.prepare`.

    Parameters
    ----------
    part : CameraPart
        Section of the rig file.
    image_wh, bits : tuple of int, int
        Size and bit depth of the pictures, as in the scene's camera.
    clock : Clock
        Clock for waiting times.
    linear : bool
        Whether the scene's camera is linear in light.

    Returns
    -------
    Camera
        Camera, not yet open.

    Raises
    ------
    RigError
        If the address is invalid for this kind of camera, or a library is missing.
    """
    settings = combine_settings(part, image_wh=image_wh, bits=bits, linear=linear)
    if part.kind == "http":
        return HttpCamera(part.address, settings, clock=clock)
    return local_camera(part, settings, clock=clock)


def local_camera(part: CameraPart, settings: CameraSettings, *, clock: Clock) -> Camera:
    """Create a camera that is connected to this computer.

    Parameters
    ----------
    part : CameraPart
        Section of the rig file.
    settings : CameraSettings
        Required settings.
    clock : Clock
        Clock for waiting times.

    Returns
    -------
    Camera
        Camera, not yet open.
    """
    if part.kind == "gphoto2":
        return GphotoCamera(part.address, settings, clock=clock, on_board=part.trigger == "board")
    return PiCamera(part.address, settings) if part.kind == "picamera2" else V4l2Camera(part.address, settings)
