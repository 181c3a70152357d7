"""Tables of traits: every trait has its row, unit and definition, and files read back."""

import csv
import io
from dataclasses import fields

import numpy as np
import pytest

from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.trait_table import DEFINITIONS, HISTOGRAMS, format_number, lines, to_csv
from rhizotwin.scenes.traits import Traits, measure_traits

TAP = Root(points_mm=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -25.0]]), diameters_mm=np.array([0.35, 0.35]), order=0, parent=-1)
BOX = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 1.0) for z in (-25.0, 0.0)])
TRAITS = measure_traits([TAP], BOX, volume_mm3=2.5, surface_mm2=27.0, mass_g=0.005)
PRINT = measure_traits([], BOX, volume_mm3=2.5, surface_mm2=27.0)


def test_every_trait_is_in_the_table_once_with_the_unit_of_its_field():
    named = [d.field for d in DEFINITIONS] + [h.field for h in HISTOGRAMS]
    assert sorted(named) == sorted(field.name for field in fields(Traits))
    assert len({d.name for d in DEFINITIONS}) == len(DEFINITIONS)
    endings = {"mm": "_mm", "mm2": "_mm2", "mm3": "_mm3", "deg": "_deg", "m/g": "_m_per_g", "g/ml": "_g_per_ml"}
    assert all(d.field.endswith(endings[d.unit]) for d in DEFINITIONS if d.unit)


def test_csv_has_a_row_a_trait_and_a_row_a_bin():
    rows = list(csv.DictReader(io.StringIO(to_csv(TRAITS, {}))))
    by_name = {row["trait"]: row for row in rows if not row["bin_to"]}
    assert (by_name["total_length_mm"]["value"], by_name["total_length_mm"]["unit"]) == ("25", "mm")
    assert float(by_name["specific_root_length_m_per_g"]["value"]) == pytest.approx(5.0)
    assert by_name["angle_to_parent_deg"]["value"] == ""
    depth = [(row["bin_from"], row["bin_to"], row["value"]) for row in rows if row["trait"] == "length_by_depth_mm"]
    assert depth == [("0", "10", "10"), ("10", "20", "10"), ("20", "30", "5")]
    diameter = [row for row in rows if row["trait"] == "length_by_diameter_mm"]
    assert [float(row["value"]) for row in diameter] == [0.0, 0.0, 0.0, 25.0]
    assert (float(diameter[3]["bin_from"]), float(diameter[3]["bin_to"]), diameter[3]["bin_unit"]) == (0.3, 0.4, "mm")


def test_a_shape_without_roots_has_dashes():
    found = [line.split()[:2] for line in lines(PRINT, {})]
    assert found[:3] == [["total_length", "-"], ["volume", "2.5"], ["surface", "27"]]
    assert next(csv.DictReader(io.StringIO(to_csv(PRINT, {}))))["value"] == ""


def test_numbers_for_people():
    assert [format_number(value) for value in (None, 95, 1650.944, 0.29933, 0.0)] == ["-", "95", "1650.9", "0.2993", "0"]
