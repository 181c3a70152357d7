"""Silhouette carving with Open3D (pip install open3d), with straight rays.

python open3d_carving.py DATASET OUTPUT
"""

import json
import sys
from pathlib import Path

import numpy as np
import open3d as o3d

dataset, output = Path(sys.argv[1]) / "undistorted", Path(sys.argv[2])
cameras = json.loads((dataset / "transforms.json").read_text())
VOXEL_MM, LOW, SIZE = 0.5, np.array([-50.0, -50.0, -125.0]), (100.0, 100.0, 115.0)
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
grid = o3d.geometry.VoxelGrid.create_dense(LOW, np.zeros(3), VOXEL_MM, *SIZE)
camera = o3d.camera.PinholeCameraParameters()
camera.intrinsic = o3d.camera.PinholeCameraIntrinsic(
    cameras["w"], cameras["h"], cameras["fl_x"], cameras["fl_y"], cameras["cx"] - 0.5, cameras["cy"] - 0.5
)
for frame in cameras["frames"]:
    mask = np.asarray(o3d.io.read_image(str(dataset / "masks" / Path(frame["file_path"]).name)), np.float32) / 255.0
    camera.extrinsic = np.linalg.inv(np.array(frame["transform_matrix"]) @ OPENCV_FROM_OPENGL)
    grid.carve_silhouette(o3d.geometry.Image(mask), camera, True)
index = np.array([voxel.grid_index for voxel in grid.get_voxels()]).reshape(-1, 3)
occupancy = np.zeros(np.ceil(np.array(SIZE) / VOXEL_MM).astype(int) + 1, bool)
occupancy[tuple(index.T)] = True
output.mkdir(parents=True)
np.savez_compressed(output / "voxels.npz", occupancy=occupancy, origin_mm=LOW, voxel_mm=VOXEL_MM)
