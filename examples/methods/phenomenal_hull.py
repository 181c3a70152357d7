"""Visual hull of Phenomenal (OpenAlea), with straight rays.

python phenomenal_hull.py DATASET OUTPUT [VOXEL_MM]
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from openalea.phenomenal.multi_view_reconstruction import reconstruction_3d
from openalea.phenomenal.object import ImageView

folder, output = Path(sys.argv[1]), Path(sys.argv[2])
dataset = folder / "undistorted" if (folder / "undistorted").is_dir() else folder
voxel_mm = float(sys.argv[3]) if len(sys.argv) > 3 else 0.5
cameras = json.loads((dataset / "transforms.json").read_text())


def projection(cam_from_world):
    """Return the function that projects points to pixels."""

    def project(points):
        x, y, z = cam_from_world[:3, :3] @ points.T + cam_from_world[:3, 3:]
        return np.column_stack([cameras["fl_x"] * x / -z + cameras["cx"], cameras["fl_y"] * -y / -z + cameras["cy"]])

    return project


views = []
for frame in cameras["frames"]:
    mask = cv2.imread(str(dataset / "masks" / Path(frame["file_path"]).name), cv2.IMREAD_GRAYSCALE)
    views.append(ImageView(mask, projection(np.linalg.inv(np.array(frame["transform_matrix"])))))
grid = reconstruction_3d(views, voxels_size=voxel_mm, voxel_center_origin=(0.0, 0.0, -75.0), start_voxel_size=200)
centres = np.asarray(grid.voxels_position)
low = centres.min(axis=0)
index = np.rint((centres - low) / voxel_mm).astype(int)
occupancy = np.zeros(index.max(axis=0) + 1, bool)
occupancy[tuple(index.T)] = True
output.mkdir(parents=True)
np.savez_compressed(output / "voxels.npz", occupancy=occupancy, origin_mm=low - voxel_mm / 2, voxel_mm=voxel_mm)
