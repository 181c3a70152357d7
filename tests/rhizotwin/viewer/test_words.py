"""Texts of the panel: traits, volume, colours and corrections."""

import re
from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.corrections import log, session
from rhizotwin.drawing import root_colours
from rhizotwin.viewer import words
from rhizotwin.viewer.app import Viewer
from rhizotwin.viewer.shown import Shown


def test_names_are_escaped(shown: Shown):
    assert "&lt;b&gt;" in words.note(shown.session.summary["scene"])
    assert "<script>" not in words.history([replace(log.edit("cut"), who="<script>")])
    told = {"name": "tips", "value": 3.0, "interval": [2.0, 4.0], "trusted": False, "verdict": "<script>"}
    assert "<script>" not in words.traits(shown.traits(), edited=False, summary=shown.session.summary | {"estimates": [told]})


def test_colours_tell_uncertainty(shown: Shown):
    lines = dict(shown.session.state.lines)
    shade = root_colours.colour_roots("uncertainty", lines)[0]
    certain = replace(lines[1], sigma_mm=np.zeros(len(lines[1].points_mm)))
    assert (shade(1, certain) == [68, 1, 84]).all()  # viridis begins so
    assert (shade(1, replace(lines[1], sigma_mm=lines[1].diameters_mm)) == [253, 231, 37]).all()
    assert (shade(1, replace(lines[1], sigma_mm=None)) == root_colours.UNKNOWN).all()
    unknown = {number: replace(line, sigma_mm=None) for number, line in lines.items()}
    assert "±" in words.root(1, lines, 1)
    assert "±" not in words.root(1, unknown, 1)
    assert "distance from the base (mm)" in words.root(1, unknown, 1)


def test_unreliable_traits_are_not_called_unassessed(shown: Shown):
    found, summary = shown.traits(), shown.session.summary
    length = found.total_length_mm
    interval = [0.9 * length, 2.0 * length]
    estimate = {"name": "total_length_mm", "value": length, "interval": interval, "trusted": False, "verdict": "too thin"}
    table = words.traits(found, edited=True, summary=summary | {"estimates": [estimate]})
    refused = re.findall(r"<td>([^<]*)</td><td>[^<]*<br><small>not reliable</small>", table)
    assert refused[0] == "Total root length"
    assert "Mean diameter" not in refused
    assert table.count("no interval after corrections") > 5
    table = words.traits(found, edited=True, summary=summary | {"volume_trusted": False})
    assert "no interval" not in table


@pytest.mark.parametrize(
    ("trusted", "shown"), [(True, "<b>0.95 ml</b> (-5.00 %), 12 mm"), (False, "0.95 ml (-5.00 %), which is not reliable")]
)
def test_a_corrected_volume_is_as_reliable_as_that_of_the_result(trusted: bool, shown: str):
    summary = {"volume_mm3": 1000.0, "volume_interval_mm3": [900.0, 1100.0], "volume_trusted": trusted, "volume_verdict": "blurred"}
    measured = session.Measured(volume_mm3=950.0, length_mm=12.0, roots=2, volumes_mm3=np.zeros(0), solid=None)
    head = words.volume(summary | {"checks": [], "warnings": []}, measured, edits=1)
    assert f"after corrections: {shown}" in head
    assert f"aria-label={'good' if trusted else 'bad'}" in head


def test_traits_follow_corrections(viewer: Viewer):
    viewer.correct("delete roots", roots=[1])
    assert viewer.shown.traits().roots == 3
    viewer.correct("delete roots", roots=[3])
    viewer.undo_to(1)
    assert sorted(viewer.shown.session.state.lines) == [0, 2, 3]
    viewer.redo()
    assert sorted(viewer.shown.session.state.lines) == [0, 2]
