"""Screenshots and turntable movies of the 3D view, rendered by the browser that requests them."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image

FRAMES, FRAME_MS = 60, 70
"""Number of frames in a turntable movie, and duration of a frame, ms. One revolution takes 4.2 s."""
WIDEST_PX = 640
"""Maximum width of a movie, pixels."""
TIMEOUT_S = 60.0
"""Timeout for rendering a frame, s. Software rendering on a busy computer takes seconds."""


def screenshot(client: viser.ClientHandle) -> bytes:
    """Render the current view of a browser as a PNG image with a transparent background."""
    camera = client.camera
    image = client.get_render(camera.image_height, camera.image_width, transport_format="png", timeout=TIMEOUT_S)
    return _encode(Image.fromarray(image), "PNG")


def turntable(client: viser.ClientHandle, *, frames: int = FRAMES, progress: Callable[[float], object] = lambda _: None) -> bytes:
    """Render a movie (GIF) in which the camera of a browser rotates once about the vertical axis.

    Parameters
    ----------
    client : viser.ClientHandle
        Browser whose camera defines distance, height and viewing direction.
    frames : int
        Number of frames.
    progress : callable
        Function that is called after each frame with the completed fraction.
    """
    camera = client.camera
    width = min(WIDEST_PX, camera.image_width)
    height = round(width * camera.image_height / camera.image_width)
    images = []
    for number, (wxyz, position) in enumerate(orbit(np.asarray(camera.wxyz), camera.position, camera.look_at, frames)):
        image = client.get_render(height, width, wxyz=wxyz, position=position, fov=camera.fov, timeout=TIMEOUT_S)
        images.append(Image.fromarray(image[..., :3]).quantize(256))
        progress((number + 1) / frames)
    return _encode(images[0], "GIF", save_all=True, append_images=images[1:], duration=FRAME_MS, loop=0)


def orbit(
    wxyz: NDArray[np.float64], position: NDArray[np.float64], centre: NDArray[np.float64], frames: int
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield the poses of a camera during one revolution about a vertical axis.

    A pose consists of an orientation, as a quaternion (w, x, y, z), and a position (3,).
    """
    start = viser.transforms.SO3(wxyz)
    for angle in np.arange(frames) * 2.0 * np.pi / frames:
        turn = viser.transforms.SO3.from_z_radians(angle)
        yield np.asarray((turn @ start).wxyz), np.asarray(turn.as_matrix() @ (position - centre) + centre)


def _encode(image: Image.Image, kind: str, **options: object) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()
