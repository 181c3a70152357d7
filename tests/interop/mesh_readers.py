"""Read exported meshes and voxels with another program, in an environment that has only this program and NumPy.

``python mesh_readers.py PROGRAM FOLDER`` prints a JSON object: for each file volume, centroid and lowest point, mm.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

FROM_LPS = np.array([-1.0, -1.0, 1.0])
"""ITK converts the axes of NIfTI (right, anterior, superior) to left, posterior, superior."""


def of_mesh(vertices: Any, faces: Any, *, unit_mm: float = 1.0) -> list[float]:
    """Return volume, mm3, centroid (x, y, z) and lowest z, mm, of a closed mesh."""
    points = unit_mm * np.asarray(vertices, float)
    a, b, c = (points[np.asarray(faces, int)[:, k]] for k in range(3))
    parts = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return [float(parts.sum()), *map(float, parts @ (a + b + c) / 4.0 / parts.sum()), float(points[:, 2].min())]


def of_voxels(values: Any, affine: Any) -> list[float]:
    """Return the numbers of an array (X, Y, Z) with the matrix (3, 4) from its indices to mm."""
    affine, index = np.asarray(affine, float)[:3], np.argwhere(np.asarray(values) > 0)
    share, centres = np.asarray(values)[tuple(index.T)] / 255.0, index @ affine[:, :3].T + affine[:, 3]
    lowest = centres[:, 2].min() - np.abs(affine[2, :3]).sum() / 2.0
    return [float(share.sum() * abs(np.linalg.det(affine[:, :3]))), *map(float, share @ centres / share.sum()), float(lowest)]


def with_meshio(folder: Path) -> dict[str, list[float]]:
    import meshio

    read = {name: meshio.read(folder / name) for name in ("a.ply", "a.stl", "a.obj")}
    return {name: of_mesh(mesh.points, mesh.cells_dict["triangle"]) for name, mesh in read.items()}


def with_vtk(folder: Path) -> dict[str, list[float]]:
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    def output(reader: Any, name: str) -> Any:
        reader.SetFileName(str(folder / name))
        reader.Update()
        return reader.GetOutputDataObject(0)

    found = {}
    for name, reader in (("a.ply", vtk.vtkPLYReader()), ("a.stl", vtk.vtkSTLReader()), ("a.obj", vtk.vtkOBJReader())):
        mesh = output(reader, name)
        found[name] = of_mesh(vtk_to_numpy(mesh.GetPoints().GetData()), vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3))
    gltf = vtk.vtkCompositeDataGeometryFilter()
    gltf.SetInputDataObject(output(vtk.vtkGLTFReader(), "a.glb"))
    gltf.Update()
    points = vtk_to_numpy(gltf.GetOutput().GetPoints().GetData())[:, [0, 2, 1]] * [1.0, -1.0, 1.0]  # z up
    found["a.glb"] = of_mesh(points, vtk_to_numpy(gltf.GetOutput().GetPolys().GetConnectivityArray()).reshape(-1, 3), unit_mm=1000.0)
    nifti = vtk.vtkNIFTIImageReader()
    readers = {"a.nrrd": vtk.vtkNrrdReader(), "a.vtk": vtk.vtkStructuredPointsReader(), "a.nii.gz": nifti, "a.tif": vtk.vtkTIFFReader()}
    for name, reader in readers.items():
        image = output(reader, name)
        spacing, origin = np.array(image.GetSpacing()), np.array(image.GetOrigin())
        values = vtk_to_numpy(image.GetPointData().GetScalars()).reshape(image.GetDimensions(), order="F")
        if name == "a.nii.gz":  # the matrix, not the origin, states the place
            matrix = nifti.GetSFormMatrix()
            origin = np.array([matrix.GetElement(k, 3) for k in range(3)])
        if name == "a.tif":
            values, spacing, origin = tiff(values, folder)
        found[name] = of_voxels(values, np.column_stack([np.diag(spacing), origin]))
    return found


def tiff(values: Any, folder: Path) -> tuple[Any, Any, Any]:
    """Return pages with the sizes that ImageJ's description states, as libtiff's readers state neither spacing nor place."""
    described = dict(line.split("=", 1) for line in (folder / "a.tif.txt").read_text().split("\n") if "=" in line)
    spacing = np.full(3, float(described["spacing"]))
    return values, spacing, -spacing * [float(described[f"{axis}origin"]) for axis in "xyz"]


def with_simpleitk(folder: Path) -> dict[str, list[float]]:
    import SimpleITK

    found = {}
    for name in ("a.nrrd", "a.nii.gz", "a.vtk", "a.tif"):
        image = SimpleITK.ReadImage(str(folder / name))
        values = SimpleITK.GetArrayFromImage(image).T
        affine = np.array([image.TransformIndexToPhysicalPoint([int(k == axis) for k in range(3)]) for axis in (0, 1, 2, 3)]).T
        affine[:, :3] -= affine[:, 3:]
        if name == "a.nii.gz":
            affine *= FROM_LPS[:, None]
        if name == "a.tif":
            values, spacing, origin = tiff(values, folder)
            affine = np.column_stack([np.diag(spacing), origin])
        found[name] = of_voxels(values, affine)
    return found


def with_nibabel(folder: Path) -> dict[str, list[float]]:
    import nibabel

    image = nibabel.load(folder / "a.nii.gz")
    assert image.header.get_xyzt_units()[0] == "mm"
    return {"a.nii.gz": of_voxels(np.asarray(image.dataobj), image.affine)}


def with_pymeshlab(folder: Path) -> dict[str, list[float]]:
    import pymeshlab

    found = {}
    for name in ("a.ply", "a.stl", "a.obj", "a.3mf", "a.glb"):
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(str(folder / name))
        mesh = meshes.current_mesh()
        points = mesh.transformed_vertex_matrix()
        if name == "a.glb":
            points = points[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
        found[name] = of_mesh(points, mesh.face_matrix(), unit_mm=1000.0 if name == "a.glb" else 1.0)
    return found


def with_bpy(folder: Path) -> dict[str, list[float]]:
    import bpy

    steps = {
        "a.ply": bpy.ops.wm.ply_import,
        "a.stl": bpy.ops.wm.stl_import,
        "a.obj": lambda filepath: bpy.ops.wm.obj_import(filepath=filepath, forward_axis="Y", up_axis="Z"),  # not its defaults
        "a.glb": bpy.ops.import_scene.gltf,
    }
    found = {}
    for name, read in steps.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        read(filepath=str(folder / name))
        (one,) = (one for one in bpy.context.scene.objects if one.type == "MESH")
        one.data.calc_loop_triangles()
        points = [one.matrix_world @ vertex.co for vertex in one.data.vertices]
        found[name] = of_mesh(
            points, [tuple(part.vertices) for part in one.data.loop_triangles], unit_mm=1000.0 if name == "a.glb" else 1.0
        )
    return found


PROGRAMS = {
    "meshio": with_meshio,
    "vtk": with_vtk,
    "SimpleITK": with_simpleitk,
    "nibabel": with_nibabel,
    "pymeshlab": with_pymeshlab,
    "bpy": with_bpy,
}

if __name__ == "__main__":
    print(json.dumps(PROGRAMS[sys.argv[1]](Path(sys.argv[2]))))
