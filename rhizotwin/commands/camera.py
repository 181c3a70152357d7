"""Command `rhizotwin camera`."""

from typing import Annotated

from rhizotwin.scenes import files
from rhizotwin.scenes.model import Scene
from rhizotwin.steps.arguments import Port, SceneName, with_metavar

DEFAULT_PORT = 8471


def camera(
    rig: Annotated[str, with_metavar("RIG")],
    /,
    *,
    scene: SceneName | None = None,
    host: Annotated[str, with_metavar("ADDRESS")] = "127.0.0.1",
    port: Port = DEFAULT_PORT,
) -> None:
    """Make the camera of this computer available to another computer.

    The camera in the rig file can then be used over HTTP by a computer whose rig file has kind = "http" in the [camera]
    section. There is no password, and by default only connections from this computer are accepted. Press Ctrl-C to
    stop.

    Parameters
    ----------
    rig : str
        Rig file (TOML) that describes the camera of this computer; 'rhizotwin rig example' writes an example.
    scene : str, optional
        Scene (name or file) whose picture size is used until a scan requests another size; default: 800x600 pixels.
    host : str
        Network address of this computer; 0.0.0.0 accepts connections from other computers.
    port : int
        Port for connections.

    Examples
    --------
    rhizotwin camera my_rig.toml
    rhizotwin camera my_rig.toml --host 0.0.0.0 --port 8471
    """
    from rhizotwin.rig.cameras.server import serve_camera
    from rhizotwin.rig.rig_file import load_rig

    part = load_rig(rig).camera
    lens = (files.load_scene(scene) if scene else Scene()).camera
    serve_camera(part, image_wh=lens.image_wh, bits=lens.bits, host=host, port=port, say=print)
