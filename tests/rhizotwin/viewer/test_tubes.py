"""Roots as they are drawn: near enough to the round tubes, with few triangles, in files that others can read."""

import io
import json
import struct

import numpy as np
import pytest
import trimesh

from rhizotwin.corrections.lines import Line
from rhizotwin.viewer import tubes
from rhizotwin.viewer.glb import glb

GREY = np.array([100, 120, 140], np.uint8)


def line(points: np.ndarray, diameters: np.ndarray) -> Line:
    return Line(points_mm=points, diameters_mm=diameters, parent=-1, pieces=())


def straight(count: int) -> Line:
    return line(np.linspace([0.0, 0.0, 0.0], [3.0, 1.0, -40.0], count), np.linspace(0.6, 0.2, count))


def winding() -> Line:
    way = np.linspace(0.0, 1.0, 200)
    points = np.stack([3.0 * np.sin(9.0 * way), 2.0 * np.cos(7.0 * way), -50.0 * way], axis=1)
    return line(points, 0.4 + 0.1 * np.sin(20.0 * way))


def shades(*lines: Line) -> list[np.ndarray]:
    return [np.tile(GREY, (len(one.points_mm), 1)) for one in lines]


def test_what_is_left_out_is_near_what_is_drawn():
    root = winding()
    keep = np.flatnonzero(tubes.select_nodes([root], shades(root)[0]))
    assert len(keep) < 0.4 * len(root.points_mm)
    every = np.arange(len(root.points_mm))
    between = np.stack([np.interp(every, keep, root.points_mm[keep, k]) for k in range(3)], axis=1)
    assert np.linalg.norm(between - root.points_mm, axis=1).max() <= tubes.OFF_MM
    assert np.abs(np.interp(every, keep, root.diameters_mm[keep]) - root.diameters_mm).max() <= 2.0 * tubes.OFF_MM


def test_normals_point_outward():
    solid = tubes.mesh_lines([winding(), straight(65)], shades(winding(), straight(65)))
    assert np.linalg.norm(solid.normals, axis=1) == pytest.approx(np.ones(len(solid.normals)))
    a, b, c = (solid.vertices_mm[solid.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    assert (np.einsum("ij,ikj->ik", across, solid.normals[solid.faces]).mean(axis=1) > 0.0).mean() > 0.99
    assert trimesh.Trimesh(solid.vertices_mm, solid.faces).is_watertight


@pytest.mark.parametrize("lit", [True, False])
def test_files_are_read_by_others_as_they_were_meant(lit: bool):
    solid = tubes.mesh_lines([winding()], shades(winding()))
    data = glb(solid, lit=lit)
    found = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh", process=False)
    assert np.asarray(found.vertices) == pytest.approx(solid.vertices_mm, abs=1e-5)
    assert (np.asarray(found.faces) == solid.faces).all()
    length = struct.unpack_from("<I", data, 12)[0]
    described = json.loads(data[20 : 20 + length])
    begin = [28 + length + view["byteOffset"] for view in described["bufferViews"]]
    normals = np.frombuffer(data, "<f4", solid.normals.size, begin[1]).reshape(-1, 3)
    assert normals == pytest.approx(solid.normals, abs=1e-6)
    assert ("alphaMode" in described["materials"][0]) != lit
    light = ((GREY / 255.0 + 0.055) / 1.055) ** 2.4  # IEC 61966-2-1: glTF's colours are linear in light
    kept = np.frombuffer(data, np.uint8, 4, begin[2])
    assert kept / 255.0 == pytest.approx([*light, 1.0], abs=0.5 / 255)
