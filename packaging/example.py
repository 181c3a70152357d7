"""Make the finished example of the package, rhizotwin/steps/example.tar.xz, from the current code.

    python packaging/example.py

It simulates and reconstructs a print, and deletes a doubtful root, as a person would do in the viewer. Truth, report
and pictures are left out: the archive must be small, and the last two are written when it is unpacked.
"""

import json
import shutil
import sys
import tarfile
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import rhizotwin as rt
from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from rhizotwin.drawing import surface_mesh
from rhizotwin.scenes.atomic import write_json
from rhizotwin.stored import result_files

ROOT = Path(__file__).resolve().parents[1]
SCENE, PROFILE, VIEWS, IMAGE_WH, BITS, VOXEL_MM = "printed_8ml", "clean", 21, (400, 300), 8, 0.5
"""Scan of the example, which is small enough for a package: thicker roots are reliable in small pictures."""
TRIANGLES = 24_000
"""Number of triangles of the stored surface."""
LEFT_OUT = ("report.html", "pictures", "seen")


def main() -> int:
    """Write the archive."""
    goal = ROOT / "rhizotwin" / "steps" / "example.tar.xz"
    with tempfile.TemporaryDirectory() as temporary:
        dataset, result = Path(temporary) / "dataset", Path(temporary) / "result"
        scene = rt.load_scene(SCENE, profile=PROFILE, views=VIEWS, image_wh=IMAGE_WH)
        rt.simulate(replace(scene, camera=replace(scene.camera, bits=BITS)), dataset)
        shutil.rmtree(dataset / "truth")
        rt.reconstruct(dataset, voxel_mm=VOXEL_MM).save(result)
        for name in LEFT_OUT:
            path = result / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        with np.load(result / "shape.npz") as stored:
            arrays = dict(stored)
        np.savez(result / "shape.npz", **arrays)  # xz compresses better than zip
        surface = surface_mesh.close(surface_mesh.simplify(result_files.read_mesh(result / "shape.ply"), TRIANGLES))
        trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False).export(result / "shape.ply")
        correct(result)
        write_json(result / "result.json", json.loads((result / "result.json").read_text()) | {"dataset": "dataset"})
        with tarfile.open(goal, "w:xz", preset=9) as archive:
            for folder in (dataset, result):
                archive.add(folder, folder.name, filter=anonymous)
        for path in sorted(path for folder in (dataset, result) for path in folder.iterdir()):
            size = sum(file.stat().st_size for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file())
            sys.stdout.write(f"{path.relative_to(temporary)}: {size / 1e6:.2f} MB\n")
    sys.stdout.write(f"{goal}: {goal.stat().st_size / 1e6:.2f} MB\n")
    return 0


def correct(result: Path) -> None:
    """Delete the shortest root without laterals whose tip no picture shows, and save the correction."""
    session = Session(result)
    parents = {root.parent for root in session.roots}
    hidden = [k for k, root in enumerate(session.roots) if not root.tip_seen and k not in parents]
    shortest = min(hidden or range(1, len(session.roots)), key=lambda k: session.state.lines[k].length_mm)
    session.do(log.edit("delete roots", roots=[shortest], who="example"))
    session.save()


def anonymous(member: tarfile.TarInfo) -> tarfile.TarInfo:
    """Return a member of the archive without user and time."""
    member.uid, member.gid, member.uname, member.gname, member.mtime = 0, 0, "", "", 0
    return member


if __name__ == "__main__":
    sys.exit(main())
