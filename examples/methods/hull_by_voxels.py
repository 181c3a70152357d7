"""Minimal method: a voxel is kept unless a mask excludes its centre, with straight rays.

python hull_by_voxels.py DATASET OUTPUT
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

dataset, output = Path(sys.argv[1]) / "undistorted", Path(sys.argv[2])
cameras = json.loads((dataset / "transforms.json").read_text())
VOXEL_MM = 0.5
low, high = np.array([-50.0, -50.0, -125.0]), np.array([50.0, 50.0, -10.0])
shape = np.ceil((high - low) / VOXEL_MM).astype(int)
centres = np.stack(np.meshgrid(*(low[k] + VOXEL_MM * (np.arange(shape[k]) + 0.5) for k in range(3)), indexing="ij"), axis=-1).reshape(-1, 3)
inside = np.ones(len(centres), bool)
for frame in cameras["frames"]:
    mask = cv2.imread(str(dataset / "masks" / Path(frame["file_path"]).name), cv2.IMREAD_GRAYSCALE)
    x, y, z = (np.linalg.inv(np.array(frame["transform_matrix"])) @ np.append(centres[inside], np.ones((inside.sum(), 1)), axis=1).T)[:3]
    u = np.round(cameras["fl_x"] * x / -z + cameras["cx"] - 0.5).astype(int).clip(0, mask.shape[1] - 1)
    v = np.round(cameras["fl_y"] * -y / -z + cameras["cy"] - 0.5).astype(int).clip(0, mask.shape[0] - 1)
    inside[inside] = mask[v, u] > 0
output.mkdir(parents=True)
np.savez_compressed(output / "voxels.npz", occupancy=inside.reshape(shape), origin_mm=low, voxel_mm=VOXEL_MM)
