"""Response curve of imported pictures: the one that the files state, or that is assumed for them."""

from dataclasses import replace
from pathlib import Path

from rhizotwin.scenes import transfer
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.model import Scene

_JPEG = b"\xff\xd8\xff"


def with_response(scene: Scene, paths: list[Path], *, verified: bool) -> tuple[Scene, str]:
    """Return the scene with the response curve of pictures that state none, and a note about the curves.

    JPEG is made for sRGB (ITU-T T.871 refers to its predecessor), and programs that write it apply that curve. JPEG
    files without a statement are therefore assumed to be sRGB, unless the scene states another curve than linear.

    Parameters
    ----------
    scene : Scene
        Scene of the pictures.
    paths : list of Path
        Picture files, except raw pictures.
    verified : bool
        Whether the reconstruction verifies the curve by the marker strip.

    Raises
    ------
    UserError
        If JPEG files and other files state no curve, because they probably have different curves.
    """
    stated = {path: curve for path in paths if (curve := transfer.read_stated_curve(path)) is not None}
    silent = [path for path in paths if path not in stated]
    words = [f"{', '.join(sorted({curve.name for curve in stated.values()}))}, as stated in the pictures"] if stated else []
    jpegs = [path for path in silent if _is_jpeg(path)]
    if not silent:
        pass
    elif not jpegs or scene.camera.transfer != "linear":
        which = f"the {count(len(silent), 'picture')} that do" if stated else "the pictures, which do"
        words.append(f"{transfer.camera_curve(scene.camera).name}, as in the scene's camera, for {which} not state it")
    elif len(jpegs) < len(silent):
        other = next(path for path in silent if path not in jpegs)
        raise UserError(
            f"{jpegs[0]} and {other} state no response curve; that of JPEG is usually sRGB, and that of other files linear. Save all "
            "pictures in one format"
        )
    else:
        scene = replace(scene, camera=replace(scene.camera, transfer="srgb"))
        check = "'rhizotwin reconstruct' verifies it by the marker strip"
        if not verified:
            linear = 'transfer = "table" and transfer_table = [0.0, 1.0]'
            check = f"it is not verified without the marker strip; if the pictures are linear, set {linear} in the scene's [camera]"
        words.append(f"sRGB is assumed for {count(len(jpegs), 'JPEG picture')} without a statement (ICC, EXIF); {check}")
    return scene, f"response curve: {'; '.join(words)}"


def _is_jpeg(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(3) == _JPEG
