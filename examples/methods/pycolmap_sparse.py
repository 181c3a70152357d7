"""Sparse points of COLMAP (pip install pycolmap) with the given cameras and straight rays.

python pycolmap_sparse.py DATASET OUTPUT
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap

dataset, output = Path(sys.argv[1]), Path(sys.argv[2])
with tempfile.TemporaryDirectory() as working:
    database, model = Path(working) / "database.db", Path(working) / "model"
    known = pycolmap.Reconstruction(str(dataset / "colmap"))
    names = [Path(image.name).name for image in known.images.values()]
    reader = pycolmap.ImageReaderOptions()
    (lens,) = known.cameras.values()
    reader.camera_model, reader.camera_params = "FULL_OPENCV", ",".join(str(value) for value in lens.params)
    pycolmap.extract_features(
        database, dataset / "images", image_names=names, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader
    )
    pycolmap.match_exhaustive(database)
    with pycolmap.Database.open(str(database)) as stored:
        number = {image.name: image.image_id for image in stored.read_all_images()}
        lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"]
        for image in known.images.values():
            pose = image.cam_from_world()
            x, y, z, w = pose.rotation.quat
            name = Path(image.name).name
            lines += [" ".join(map(str, (number[name], w, x, y, z, *pose.translation, 1, name))), ""]
    given = Path(working) / "given"
    given.mkdir()
    (given / "images.txt").write_text("\n".join(lines) + "\n")
    (given / "cameras.txt").write_text((dataset / "colmap" / "cameras.txt").read_text())
    (given / "points3D.txt").write_text("")
    model.mkdir()
    found = pycolmap.triangulate_points(pycolmap.Reconstruction(str(given)), database, dataset / "images", model)
    points = np.array([point.xyz for point in found.points3D.values()]).reshape(-1, 3)
water = (np.hypot(points[:, 0], points[:, 1]) < 73.0) & (points[:, 2] < -8.0) & (points[:, 2] > -146.0)
output.mkdir(parents=True)
np.savetxt(output / "points.xyz", points[water])
