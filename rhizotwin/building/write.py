"""Output of the printed parts of a rig as meshes, drawings, pictures and tables of parameters."""

import csv
import io
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import Manifold
from tqdm import tqdm

from rhizotwin.building.drawings import exploded, exploded_page, part_page, rig_page
from rhizotwin.building.line_drawing import CORNER
from rhizotwin.building.measures import Measures
from rhizotwin.building.part import Part, check_bed, check_whole, surface
from rhizotwin.building.rig_parts import Bought, bought_of, collisions, parts_of
from rhizotwin.building.wiring import wiring_pages
from rhizotwin.drawing.shading import rasterise, shade
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.rig.printing.print_files import write_pages
from rhizotwin.rig.rig_file import HatPart, RigFile
from rhizotwin.scenes.atomic import write_bytes, write_image, write_json, write_text
from rhizotwin.scenes.board import CharucoBoard
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.model import Scene

PICTURE_PX = 1100
"""Length of the longer side of the rendered pictures, in pixels. They are then reduced by a factor of two to smooth the
edges."""
COLOURS = {
    "canister": (0.75, 0.85, 0.95),
    "tank": (0.80, 0.88, 0.92),
    "motor": (0.35, 0.35, 0.38),
    "bar": (0.7, 0.7, 0.72),
    "diffuser": (0.95, 0.95, 0.9),
    "LED board": (0.8, 0.8, 0.75),
    "lamp diffuser": (0.95, 0.95, 0.9),
    "lamp LED board": (0.8, 0.8, 0.75),
}
PRINTED = (0.95, 0.62, 0.25)


def write_parts(
    scene: Scene,
    folder: Path,
    *,
    rig: RigFile,
    measures: Measures,
    bed_mm: tuple[float, float, float],
    names: Sequence[str] = (),
) -> list[Part]:
    """Write all files that are needed to print and assemble the parts to a folder.

    If ``names`` are given, only these parts are written, without drawings, pictures and wiring of the complete rig. All
    parts are checked for collisions in any case.

    Parameters
    ----------
    scene : Scene
        Scene for which the parts are made.
    folder : Path
        New or empty output folder.
    rig : RigFile
        Rig with the positions of arm and floor, and the pins of the hat.
    measures : Measures
        Dimensions of purchased parts.
    bed_mm : tuple of float
        Build volume of the printer: width, depth and height.
    names : sequence of str
        Names of the parts to write; if empty, all parts are written.

    Returns
    -------
    list of Part
        Written parts.

    Raises
    ------
    UserError
        If a name is unknown, a part cannot be built, does not fit the build volume or collides with another part, or
        the folder is not empty.
    """
    parts = parts_of(scene, rig=rig, measures=measures, board=CharucoBoard())
    wanted = _wanted(parts, names)
    for part in wanted:
        check_whole(part)
        check_bed(part, bed_mm)
    bought = bought_of(scene, rig=rig, measures=measures)
    for one, other, mm3 in collisions(parts, bought):
        raise UserError(f"the parts {one} and {other} overlap by {mm3:.1f} mm3; change the scene, the rig file or the dimensions")
    with new_folder(folder) as inside:
        for part in tqdm(wanted, desc="parts", unit="part", leave=False):
            write_bytes(inside / f"{part.name}.stl", stl_bytes(part.printed))
            write_pages([part_page(part, title=scene.name)], inside / "drawings" / f"{part.name}.svg", title=f"{part.name} of {scene.name}")
        write_text(inside / "parameters.csv", _csv(wanted))
        write_json(inside / "parameters.json", _json(scene, wanted, measures))
        if not names:
            _write_whole(inside, parts, bought, hat=rig.hat, title=scene.name)
    return wanted


def _wanted(parts: Sequence[Part], names: Sequence[str]) -> list[Part]:
    """Return the parts with the given names, or all parts if ``names`` is empty."""
    unknown = [name for name in names if name not in {part.name for part in parts}]
    if unknown:
        raise UserError(f"the part {unknown[0]!r} is unknown; choose from {', '.join(part.name for part in parts)}")
    return [part for part in parts if part.name in names or not names]


def _write_whole(folder: Path, parts: Sequence[Part], bought: Sequence[Bought], *, hat: HatPart, title: str) -> None:
    """Write the drawings and pictures of the complete rig, and the wiring diagrams."""
    drawings = folder / "drawings"
    write_pages([rig_page(parts, bought, title=title)], drawings / "rig.svg", title=f"rig of {title}")
    write_pages([exploded_page(parts, bought, title=title)], drawings / "exploded.svg", title=f"parts of {title}")
    for name, page in wiring_pages(hat).items():
        write_pages([page], drawings / f"wiring_{name}.svg", title=f"wiring, {name}")
    write_image(folder / "exploded.png", exploded_picture(parts, bought))


def stl_bytes(solid: Manifold) -> bytes:
    """Return the content of a binary STL file with the surface of a solid in mm."""
    vertices, faces = surface(solid)
    return bytes(trimesh.Trimesh(vertices=vertices, faces=faces, process=False).export(file_type="stl"))


def _csv(parts: Sequence[Part]) -> str:
    lines = io.StringIO()
    table = csv.writer(lines, lineterminator="\n")
    table.writerow(["part", "pieces", "parameter", "value", "from"])
    for part in parts:
        for name, value, source in _numbers(part):
            table.writerow([part.name, part.pieces, name, f"{value:.6g}", source])
    return lines.getvalue()


def _json(scene: Scene, parts: Sequence[Part], measures: Measures) -> dict[str, object]:
    return {
        "scene": scene.name,
        "measures": {f.name: getattr(measures, f.name) for f in fields(measures)},
        "parts": [
            {
                "name": part.name,
                "pieces": part.pieces,
                "about": part.about,
                "support": part.support,
                "parameters": {name: {"value": value, "from": source} for name, value, source in _numbers(part)},
            }
            for part in parts
        ],
    }


def _numbers(part: Part) -> list[tuple[str, float, str]]:
    sizes = zip(("bed_width_mm", "bed_depth_mm", "bed_height_mm"), part.size_mm, strict=True)
    return [
        *part.numbers,
        *((name, size, "printing orientation") for name, size in sizes),
        ("volume_mm3", part.solid.volume(), "of plastic"),
    ]


def exploded_picture(parts: Sequence[Part], bought: Sequence[Bought]) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Render the exploded view of the rig as a picture (H, W, 3), with printed parts in orange."""
    things = [(COLOURS.get(name, PRINTED), surface(solid)) for name, solids in exploded(parts, bought) for solid in solids]
    view = np.concatenate([vertices @ CORNER.axes.T for _, (vertices, _) in things])
    low = view.min(axis=0)[:2] - 10.0
    high = view.max(axis=0)[:2] + 10.0
    px_mm = float((high - low).max()) / PICTURE_PX
    box = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    picture = nearest = None
    for colour, (vertices, faces) in things:
        # separate vertices for each triangle keep edges sharp
        mesh = Mesh(vertices_mm=vertices[faces].reshape(-1, 3), faces=np.arange(3 * len(faces)).reshape(-1, 3))
        raster = rasterise(mesh, CORNER, box_mm=box, px_mm=px_mm)
        rgba = shade(raster, colour, px_mm=px_mm, flat=False)
        depth = np.where(raster.hit, raster.depth_mm, -np.inf)
        if picture is None or nearest is None:
            picture = np.ones((*raster.hit.shape, 3))
            nearest = np.full(raster.hit.shape, -np.inf)
        front = depth > nearest
        picture[front] = rgba[front][:, :3]
        nearest[front] = depth[front]
    if picture is None:
        raise UserError("the exploded view has no parts")
    half = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
    half = half.reshape(half.shape[0] // 2, 2, half.shape[1] // 2, 2, 3).mean(axis=(1, 3))
    return np.asarray(np.rint(255.0 * half), dtype=np.uint8)
