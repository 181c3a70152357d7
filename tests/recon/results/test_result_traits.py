"""Traits of result folders: surfaces of thin and thick roots, tables of many results, errors against a truth."""

import csv
import io
import json

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.results import result_traits
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.rsml import Root, write_rsml
from rhizotwin.scenes.traits import measure_traits
from rhizotwin.scoring.score_traits import compare_traits
from rhizotwin.stored import result_files, stored_traits


def root(start, end, diameter_mm, **kind) -> Root:
    points = np.linspace(start, end, 20)
    return Root(points_mm=points, diameters_mm=np.full(20, diameter_mm), **{"order": 0, "parent": -1} | kind)


THICK = root([0.0, 0.0, -10.0], [0.0, 0.0, -50.0], 4.0)
THIN = root([0.0, 0.0, -30.0], [30.0, 0.0, -30.0], 0.3, order=1, parent=0)


def of(mesh: trimesh.Trimesh, roots, **given):
    corners = np.zeros(3), np.ones(3)
    return result_traits.measure_shape(Mesh.of(mesh), roots, volume_mm3=500.0, finest_mm=0.14, extents_mm=corners, **given)


def test_thin_roots_are_measured_as_tubes_and_thick_ones_on_the_mesh():
    organ = trimesh.creation.cylinder(radius=2.0, height=40.0, sections=256)
    organ.apply_translation([0.0, 0.0, -30.0])
    eaten = trimesh.creation.cylinder(radius=0.05, height=28.0, sections=8)  # what is left of the thin root in a mesh
    eaten.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2.0, [0.0, 1.0, 0.0]))
    eaten.apply_translation([16.0, 0.0, -30.0])
    thick = 2.0 * np.pi * 2.0 * 42.0
    assert of(organ, [THICK]).surface_mm2 == pytest.approx(thick, rel=1e-3)
    assert of(organ + eaten, [THICK, THIN]).surface_mm2 == pytest.approx(thick + 2.0 * np.pi * 0.15 * 28.0, rel=5e-3)


def test_a_spreadsheet_of_two_results(scan):
    made = scan(voxel_mm=1.0)
    summary = result_files.read_summary(made.result)
    plain = stored_traits.read(made.result, mass_g=0.5)
    write_rsml(made.result / "roots.rsml", [root([4.0, -3.0, -45.0], [4.0, -3.0, -55.0], 12.0)])
    rooted = stored_traits.read(made.result)
    rows = list(csv.DictReader(io.StringIO(stored_traits.spreadsheet([("a", summary, plain), ("b, c", summary, rooted)]))))
    assert [(row["result"], row["total_length_mm"]) for row in rows] == [("a", ""), ("b, c", "10")]
    assert float(rows[0]["tissue_density_g_per_ml"]) == pytest.approx(0.5 / (summary["volume_mm3"] / 1000.0), rel=1e-5)
    assert float(rows[0]["volume_mm3_low"]) == pytest.approx(0.95 * summary["volume_mm3"], rel=1e-5)
    assert json.loads(result_traits.trait_files(rooted, summary, mass_g=None)["traits.json"])["mass_g"] is None
    made.edit_summary(mass_g=0.9)  # given at the reconstruction
    assert stored_traits.read(made.result).tissue_density_g_per_ml == pytest.approx(0.9 / (4.0 / 3.0 * np.pi * 0.216), rel=1e-2)


def test_errors_of_traits():
    skin = np.concatenate([THICK.points_mm, THIN.points_mm, [[0.0, 9.0, -20.0]]])
    true = measure_traits([THICK, THIN], skin, volume_mm3=500.0, surface_mm2=500.0)
    bent = root([0.0, 0.0, -30.0], [30.0, 0.0, -60.0], 0.3, order=1, parent=0)
    found = measure_traits([THICK, bent], skin, volume_mm3=510.0, surface_mm2=500.0)
    scores = compare_traits(found, true)
    assert scores["volume"].error == pytest.approx(0.02)
    assert scores["angle_to_parent"].error == pytest.approx(-45.0, abs=1e-6)
    assert scores["angle_to_parent"].error_unit == "deg"
    assert scores["tips"].error == 0.0
    assert compare_traits(true, true)["length_by_depth"].error == 0.0
    moved = scores["length_by_depth"].error
    assert moved is not None
    # 20 mm of the lateral have left the bin of depth 20-30 (a third of its 42.4 mm stays), and 12.4 mm are new
    assert moved == pytest.approx(0.5 * ((30.0 - 10.0 * np.sqrt(2.0)) + 20.0 * np.sqrt(2.0)) / 70.0)
    none = measure_traits([], skin, volume_mm3=510.0, surface_mm2=500.0)
    assert compare_traits(none, true)["tips"].error is None
    assert compare_traits(none, true)["length_by_depth"].error is None
