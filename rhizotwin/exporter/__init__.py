"""Export of results and specimens to other programs: meshes, voxels, roots, cameras and undistorted pictures."""
