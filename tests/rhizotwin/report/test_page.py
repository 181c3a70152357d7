"""The page of a result: what it says, that nothing in it asks a network, and that a real browser draws it."""

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from rhizotwin.corrections import log
from rhizotwin.corrections.corrected import write as write_corrected
from rhizotwin.corrections.session import Session
from rhizotwin.report import page, words
from rhizotwin.report.report_data import ReportData
from rhizotwin.scenes import frames, trait_table
from rhizotwin.scenes.assessment import NO_INTERVAL
from rhizotwin.scenes.subject import Subject
from tests.command import Command
from tests.conftest import Reconstructed
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import PATIENCE_MS

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def written(plant: plants.Plant) -> Path:
    return page.write(plant.result)


def test_the_page_of_a_solid_body(found: Reconstructed, scan):
    whole = (found.folder / "report.html").read_text(encoding="utf-8")
    assert whole.count("data:image/webp;base64,") == 2
    assert whole.count("data:image/jpeg;base64,") == 2
    assert sorted(path.name for path in (found.folder / "pictures").iterdir()) == ["shape.png"]
    made = scan(voxel_mm=1.0, lost=(3,))
    text = page.write(made.result, dataset=made.dataset).read_text(encoding="utf-8")
    for part in ("a ball &lt;6 mm&gt;", "2 markers found, 4 are needed", "No centre lines were found", "Root extent (x, y, z)"):
        assert part in text
    assert "data-file=rsml" not in text


def test_the_page_says_what_the_scan_calibrated(scan):
    made = scan(voxel_mm=1.0)
    level = frames.level_camera(distance_mm=400.0, height_mm=-42.0, tilt_deg=8.0)
    spread = np.diag([1e-8, 1e-8, 1e-8, 4e-4, 4e-4, 9e-4]).tolist()
    moved = {"own_movement_mm": 0.01, "own_movement_deg": 0.002}
    ring = {"ring": 0, "placement": 1, "cam_from_rig": level.tolist(), "covariance": spread, **moved}
    water = {"n_water": 1.33412, "n_water_given": 1.333, "n_water_found": 1.33412, "n_water_sigma": 0.00021}
    rig = {"rings": [ring], **water, "reprojection_before_px": 1.25, "reprojection_after_px": 0.037}
    made.edit_summary(rig=rig, volume_verdict="this scan <cannot> give a volume", volume_trusted=False)
    text = page.write(made.result, dataset=made.dataset).read_text(encoding="utf-8")
    parts = [
        "This scan &lt;cannot&gt; give a volume",
        "<td class=number>1.333</td><td class=number>1.33412</td><td class=number>0.00021</td>",
        "<td class=number>400.000</td><td class=number>0.030</td>",
    ]
    assert [part for part in parts if part not in text] == []


def test_the_page_asks_no_network_and_runs_nothing_of_a_name(written: Path):
    text = written.read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    assert "<b>plant" not in text
    assert text.count("</script>") == 2  # of the data and of the drawing
    assert "the views disagree about &lt;radii&gt;" in text
    assert "not assessed" not in text.split("<script type")[0] + text.split("</script>")[1]
    assert len(text) < 2e6


def _wait_until_drawn(shown: Any, more_than: int) -> None:
    """Wait until the canvas has been drawn more often; by its attribute, because the page forbids eval."""
    other = "".join(f":not([data-drawn='{times}'])" for times in range(more_than + 1))
    shown.locator(f"canvas[data-drawn]{other}").wait_for(state="attached", timeout=PATIENCE_MS)


def test_a_browser_draws_and_saves_the_page(browser: Any, plant: plants.Plant, written: Path, tmp_path: Path):
    width = 400
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme="dark", offline=True, accept_downloads=True)
    shown = context.new_page()
    shown.set_default_timeout(PATIENCE_MS)
    complaints: list[str] = []
    shown.on("console", lambda message: complaints.append(message.text) if message.type in ("error", "warning") else None)
    shown.on("pageerror", lambda error: complaints.append(str(error)))
    shown.goto(written.as_uri())
    _wait_until_drawn(shown, 0)
    assert shown.evaluate("document.documentElement.scrollWidth") <= width
    canvas = shown.locator("canvas")
    before = _pixels(canvas)
    assert 0.002 < (np.ptp(before.reshape(-1, 3).astype(int) - before[0, 0], axis=1) > 30).mean() < 0.5  # blue laterals on grey
    box = canvas.bounding_box()
    shown.mouse.move(box["x"] + 100, box["y"] + 100)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 220, box["y"] + 130)
    shown.mouse.up()
    _wait_until_drawn(shown, 1)
    turned = _pixels(canvas).astype(int)
    assert np.abs(turned - before).mean() > 0.05
    saved = {kind: tmp_path / f"saved.{kind}" for kind in ("csv", "rsml", "stl", "glb")}
    for kind, file in saved.items():
        with shown.expect_download(timeout=PATIENCE_MS) as waiting:
            shown.locator(f"button[data-file={kind}]").click()
        waiting.value.save_as(file)
    assert saved["csv"].read_bytes().startswith(b"trait,")
    assert saved["rsml"].read_bytes() == (plant.result / "roots.rsml").read_bytes()
    surfaces = [trimesh.load_mesh(saved[kind]) for kind in ("stl", "glb")]
    assert all(surface.is_watertight for surface in surfaces)
    volume_mm3 = trimesh.load_mesh(plant.result / "shape.ply").volume
    assert [surface.volume for surface in surfaces] == pytest.approx([volume_mm3, 1e-9 * volume_mm3], rel=0.01)  # glTF is in metres
    data = saved["glb"].read_bytes()
    size = int.from_bytes(data[12:16], "little")
    view = json.loads(data[20 : 20 + size])["bufferViews"][2]
    colours = np.frombuffer(data, np.uint8, view["byteLength"], 28 + size + view["byteOffset"]).reshape(-1, 4)
    assert len(np.unique(colours, axis=0)) == 2  # main root and laterals
    shown.get_by_role("combobox").select_option("uncertainty")
    shown.get_by_text("diameter ±0 %").wait_for()
    _wait_until_drawn(shown, 2)
    assert np.abs(_pixels(canvas).astype(int) - turned).mean() > 0.05
    assert complaints == []
    assert len(re.findall(rb"/Type */Page\b", shown.pdf(format="A4"))) == 1
    context.close()


def _pixels(canvas: Any) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(canvas.screenshot(timeout=PATIENCE_MS), np.uint8), cv2.IMREAD_COLOR)
    return picture[60:-40]


def test_one_page_for_many(plant: plants.Plant, tmp_path: Path):
    text = page.write_many([plant.result, plant.result], tmp_path / "many.html").read_text(encoding="utf-8")
    assert text.count("data:image/webp;base64,") == 2
    assert "<script" not in text
    assert text.count("reliable</span>") == 2
    assert "<h1>2 of 2 volumes reliable</h1>" in text
    folders = [shutil.copytree(plant.result, tmp_path / day / "result") for day in ("day_1", "day_2")]
    text = page.write_many(folders, tmp_path / "many.html").read_text(encoding="utf-8")
    assert re.findall('<a href="#result-.">([^<]*)', text) == ["day_1/result", "day_2/result"]
    for folder in folders:  # a stored picture is shown, unless the surface is newer
        page.write(ReportData.read(folder))
        picture = folder / "pictures" / "shape.png"
        picture.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(picture), np.full((8, 16, 3), 200, np.uint8))
    os.utime(folders[0] / "pictures" / "shape.png", (0, 0))
    (folders[1] / "shape.ply").unlink()
    pages = [page.write_many(order, tmp_path / "many.html").read_text(encoding="utf-8") for order in (folders, folders[::-1])]
    assert [text.index('href="day_1/result/report.html"') < text.index('href="day_2/result/report.html"') for text in pages] == [
        True,
        False,
    ]
    sizes = [[len(one) for one in re.findall('webp;base64,([^"]*)', text)] for text in pages]
    assert sizes[0] == sizes[1][::-1]
    assert sizes[0][1] < 500 < sizes[0][0]
    (folders[1] / "pictures" / "shape.png").unlink()
    drawn = page.write_many(folders, tmp_path / "many.html").read_text(encoding="utf-8")
    assert min(len(one) for one in re.findall('webp;base64,([^"]*)', drawn)) > 500  # tubes along the roots


def test_a_page_describes_corrections_and_missing_pictures(plant: plants.Plant, tmp_path: Path):
    session = Session(plant.result)
    session.do(log.edit("delete roots", roots=[1], who="ann <x>"))
    write_corrected(session, tmp_path / "new")
    assert "Edited by hand: 1 edit by ann &lt;x&gt;, -" in page.write(tmp_path / "new").read_text(encoding="utf-8")
    summary = tmp_path / "new" / "result.json"
    summary.write_text(summary.read_text().replace(str(plant.dataset), "/gone"))
    assert "The dataset was not found" in page.write(tmp_path / "new").read_text(encoding="utf-8")


SUMMARY: dict[str, Any] = {
    "volume_mm3": 137070.4,
    "volume_interval_mm3": [128000.0, 146000.0],
    "volume_trusted": True,
    "volume_verdict": "",
    "warnings": [],
    "volume_budget": [
        {"name": "a", "less_mm3": 8000.0, "more_mm3": 8000.0, "why": "of one thing"},
        {"name": "b", "less_mm3": 0.0, "more_mm3": 3000.0, "why": "of another"},
        {"name": "c", "less_mm3": 1.0, "more_mm3": 1.0, "why": "of nothing"},
    ],
}


def test_the_volume_has_no_false_precision_and_may_be_refused():
    assert words.volume_text(SUMMARY) == ("137.1 ml", "128.0 to 146.0 ml")
    causes = [(cause.why, cause.amount) for cause in words.uncertainty_causes(SUMMARY)]
    assert causes[:2] == [("of one thing", "± 8.0 ml"), ("of another", "+ 3.0 ml")]
    assert (words.uncertainty_causes(SUMMARY)[2].name, causes[2][1]) == ("1 smaller cause", "± 0.0010 ml")
    assert causes[3][1] == "− 9.1 + 8.9 ml"
    assert words.main_cause(SUMMARY) == "Largest cause of uncertainty: of one thing (± 8.0 ml)."
    assert words.uncertainty_causes(SUMMARY | {"volume_budget": []}) == []
    assert words.verdict(SUMMARY) == ("137.1 ml", "90 % between 128.0 and 146.0 ml; reliable")
    assert words.headline(SUMMARY)[0] == "volume 137.1 ml"
    headline, beside = words.headline(SUMMARY | {"volume_trusted": False})
    assert headline == "volume could not be determined"
    assert "137.1 ml" in beside
    assert "not reliable" in beside


def test_names_are_written_as_words():
    names = {"printed_8ml": "Printed 8 ml", "radish_day15b": "Radish day 15b", "radish_day05b": "Radish day 5b", "P07 N+": "P07 N+", "": ""}
    assert {name: words.title(name) for name in names} == names
    plant = Subject(plant="P07", species="Raphanus sativus", treatment="low N", day=12.0, date="2026-05-01")
    assert words.heading(plant, "my_canister") == ("P07, day 12", "Raphanus sativus, treatment low N, 2026-05-01")
    assert words.heading(Subject(day=5.0), "my_canister") == ("My canister", "day 5")


def test_a_definition_does_not_repeat_the_name():
    hull = next(definition for definition in trait_table.DEFINITIONS if definition.field == "convex_hull_mm3")
    roots = next(definition for definition in trait_table.DEFINITIONS if definition.field == "roots")
    assert words.trait_text(hull, 8000.0, NO_INTERVAL)[3] == ""
    assert words.trait_text(roots, 3, NO_INTERVAL)[3] == "taproots and laterals of every order"


def test_the_methods_of_a_baseline_are_its_own():
    summary = {"views": [{"used": True}] * 8, "voxel_mm": 0.5}
    ours = words.methods_paragraph(summary, roots=False, simulated=False)
    hull = words.methods_paragraph(summary | {"settings": {"method": "hull"}}, roots=False, simulated=False)
    assert ["trimmed to what" in text and "90 % interval" in text for text in (ours, hull)] == [True, False]
    assert "the untrimmed visual hull, a baseline without an error budget" in hull


def test_an_estimate_of_a_later_version_is_left_out():
    known = {"name": "tips", "value": 7.0, "interval": [6.0, 9.0], "trusted": True, "verdict": ""}
    summary = {"volume_trusted": True, "estimates": [known, known | {"name": "root_hairs"}]}
    assert words.root_summary(summary) == ["7 tips (6 to 9)"]


def test_the_light_follows_checks_and_trust():
    check = {"name": "motion", "state": "fair", "found": "roots sway by 0.3 px", "advice": "wait longer"}
    assert words.traffic_light(SUMMARY)[0] == "good"
    state, _, told = words.traffic_light(SUMMARY | {"checks": [check]})
    assert (state, told) == ("good", ["Roots sway by 0.3 px. Wait longer."])
    assert words.traffic_light(SUMMARY | {"checks": [check | {"state": "bad"}], "volume_trusted": False})[0] == "bad"
    assert words.traffic_light(SUMMARY | {"volume_trusted": False, "volume_verdict": "no"})[2] == ["No."]


def test_a_simulated_scan_is_called_simulated(plant: plants.Plant, written: Path, tmp_path: Path):
    text = written.read_text(encoding="utf-8")
    assert "Images of roots in a round canister" in text
    assert "imulated" not in text
    simulated = Path(shutil.copytree(plant.dataset, tmp_path / "simulated"))
    (simulated / "truth").mkdir()
    text = page.write(plant.result, dataset=simulated, output=tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Simulated images of roots in a round canister" in text
    assert "Simulated scan: a plant &lt;of paper&gt;" in text


def test_figures_are_drawn_on_demand(plant: plants.Plant, tmp_path: Path, command: Command):
    result = shutil.copytree(plant.result, tmp_path / "result")
    command.works("report", result)
    assert not (result / "pictures").exists()
    command.works("report", result, "--figures")
    assert sorted(path.name for path in (result / "pictures").iterdir()) == ["inputs.png", "roots.png", "shape.png"]
    assert "Pictures (top) and silhouettes" in (result / "report.html").read_text(encoding="utf-8")
    command.fails("report", result, result, "-o", tmp_path / "many.html", "--figures", named=["--figures", "one result"])
