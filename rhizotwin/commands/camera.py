"""`rhizotwin camera`."""

from typing import Annotated

from rhizotwin.arguments import Port, SceneName, named
from rhizotwin.scenes import files
from rhizotwin.scenes.model import Scene

DEFAULT_PORT = 8471


def camera(
    rig: Annotated[str, named("RIG")],
    /,
    *,
    scene: SceneName | None = None,
    host: Annotated[str, named("ADDRESS")] = "127.0.0.1",
    port: Port = DEFAULT_PORT,
) -> None:
    """Serve this computer's camera to another one.

    Serve the camera of a rig file over HTTP, for a computer whose rig file has kind = "http" in its [camera] section.
    Only this computer can connect unless --host says otherwise; there is no password. Ctrl-C ends it.

    Parameters
    ----------
    rig : str
        Rig file (TOML) with the camera of this computer.
    scene : str, optional
        Whose camera says the size of the pictures until a scan asks; default: 800x600.
    host : str
        Address to listen on; 0.0.0.0: all.
    port : int
        Port to listen on.

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
