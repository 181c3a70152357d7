"""The console in a browser: a scan on the emulated rig, the console killed and started again, the report at the end."""

import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import load_scene, save_scene
from rhizotwin.scenes.model import CapturePlan
from tests.rhizotwin import plant as plants
from tests.rhizotwin.browser import PATIENCE_MS, until
from tests.rhizotwin.console.conftest import Lab, console_process

pytestmark = pytest.mark.slow

VIEWS = 10
RECONSTRUCTION_MS = 1_800_000
"""Limit of a reconstruction, ms. It takes half a minute, but its process has a low priority and hardly runs on a busy computer."""


@contextmanager
def opened(browser: Any, address: str, *, password: str = "") -> Iterator[Any]:
    """Open a page; an error of its script or a refused resource fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(PATIENCE_MS)  # also of pages that this page opens
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if "Content Security Policy" in message.text else None)
    page.goto(address)
    if password:
        page.get_by_label("Password").fill(password)
        page.get_by_role("button", name="Open the console").click()
    page.locator("#activity", has_text="idle").or_(page.locator("#activity.busy")).first.wait_for()
    yield page
    context.close()
    assert not errors


def take_control(page: Any, name: str) -> None:
    page.locator("#take").click()
    page.get_by_label("Your name").fill(name)
    page.keyboard.press("Enter")
    page.get_by_text(f"You ({name}) control the rig").wait_for()


@pytest.mark.nightly
def test_a_scan_survives_the_console(browser: Any, tmp_path: Path) -> None:
    scene = load_scene("sphere_20mm")
    rings = tuple(replace(ring, views=VIEWS) for ring in scene.plan.rings[:1])
    save_scene(replace(scene, camera=scene.camera.resized((320, 240)), plan=CapturePlan(rings=rings)), tmp_path / "scene.toml")
    words = ("--rig", "twin", "--scene", tmp_path / "scene.toml", "-o", tmp_path / "lab")
    with console_process(*words, port=8790) as (process, printed), opened(browser, printed[-1]) as page:
        assert "token" not in page.url
        assert page.get_by_role("button", name="Start scan").is_disabled()
        take_control(page, "Anna")
        page.get_by_role("button", name="Check the devices").click()
        page.locator("#devices .dot.ok").nth(5).wait_for()  # all but the markers, which the parked camera does not see
        page.get_by_label("Plant").fill("P7")
        page.get_by_label("Treatment").fill("low N")
        page.get_by_role("button", name="Start scan").click()
        page.locator("#picture").wait_for()
        page.get_by_role("button", name="Pause").click()
        page.get_by_text("paused with lights, motor and arm switched on").wait_for()
        process.kill()
        page.get_by_text("no connection").wait_for()
    (folder,) = (tmp_path / "lab" / "scans").iterdir()
    assert len(load_dataset(folder).frames) < VIEWS

    with console_process(*words, port=8790) as (process, printed):
        with opened(browser, printed[-1]) as page:
            row = page.locator("#scans tbody tr")
            row.get_by_text("interrupted").wait_for()
            take_control(page, "Ben")
            row.get_by_role("button", name="Finish scan").click()
            page.get_by_text(f"{VIEWS} of {VIEWS} pictures, complete").wait_for()
            row.locator("progress").wait_for()
            report = row.get_by_role("link", name="Report")
            report.wait_for(timeout=RECONSTRUCTION_MS)
            with page.expect_popup() as popup:
                report.click()
            popup.value.get_by_text("ml").first.wait_for()
            assert "P7" in popup.value.content()
            page.get_by_text("Focus", exact=True).wait_for()
            page.get_by_text("Motion", exact=True).wait_for()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_MS / 1000.0)
    assert process.returncode == 130
    dataset = load_dataset(folder)
    assert dataset.origin["complete"]
    assert len(dataset.frames) == VIEWS
    assert dataset.scene.subject.treatment == "low N"


def test_a_password_opens_the_page_and_no_report_has_its_cookie(browser: Any, make_lab: Callable[..., Lab], plant: plants.Plant) -> None:
    lab = make_lab(password="a long password")
    shutil.copytree(plant.dataset, lab.folder / "scans" / "P7-2026-11-26")
    report = Path(shutil.copytree(plant.result, lab.folder / "results" / "P7-2026-11-26")) / "report.html"
    report.write_text("<script>document.title = 'cookie ' + (() => { try { return document.cookie } catch { return 'apart' } })()</script>")
    with opened(browser, f"http://127.0.0.1:{lab.served.port}/", password="a long password") as page:
        assert page.get_by_role("button", name="Start scan").is_disabled()
        assert not page.locator("form#line input").is_visible()  # folded until it can be used
        take_control(page, "Anna")
        page.locator("form#line input").fill("home 0")
        page.get_by_role("button", name="Run").click()
        page.get_by_text("table at 0.000 deg").wait_for()
        with page.expect_popup() as popup:
            page.locator("#scans").get_by_role("link", name="Open in viewer").click()
        popup.value.get_by_role("tab", name="Traits").wait_for()
        page.locator("#scans").get_by_role("button", name="Pictures").click()
        until(lambda: page.evaluate("document.getElementById('picture').naturalWidth"), "the first picture of the scan")
        with page.expect_popup() as popup:
            page.locator("#scans").get_by_role("link", name="Report").click()
        until(lambda: popup.value.title() == "cookie apart", "the report without the cookie")
