"""Space carving of plant-3d-vision (ROMI), with straight rays, in OpenCL.

python plant3dvision_carving.py DATASET OUTPUT [VOXEL_MM]
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from plant3dvision.cl import Backprojection

folder, output = Path(sys.argv[1]), Path(sys.argv[2])
dataset = folder / "undistorted" if (folder / "undistorted").is_dir() else folder
voxel_mm = float(sys.argv[3]) if len(sys.argv) > 3 else 0.5
cameras = json.loads((dataset / "transforms.json").read_text())
low, high = np.array([-65.0, -65.0, -140.0]), np.array([65.0, 65.0, -8.0])
shape = np.ceil((high - low) / voxel_mm).astype(int).tolist()
carving = Backprojection(shape, (low + voxel_mm / 2).tolist(), voxel_mm)
intrinsics = np.array([cameras[key] for key in ("fl_x", "fl_y", "cx", "cy")], np.float32)
for frame in cameras["frames"]:
    mask = cv2.imread(str(dataset / "masks" / Path(frame["file_path"]).name), cv2.IMREAD_GRAYSCALE)
    cam_from_world = (np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(np.array(frame["transform_matrix"]))).astype(np.float32)
    carving.process_view(intrinsics, cam_from_world[:3, :3], cam_from_world[:3, 3], mask)
output.mkdir(parents=True)
np.savez_compressed(output / "voxels.npz", occupancy=carving.get_values().reshape(shape) > 0, origin_mm=low, voxel_mm=voxel_mm)
