"""The console in a browser: a scan on the emulated rig, the console killed and started again, the report at the end."""

import os
import shutil
import signal
import subprocess
import sys
import time
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
from tests.rhizotwin.browser import PATIENCE_MS
from tests.rhizotwin.console.conftest import Lab

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
VIEWS = 24


class Server:
    """`rhizotwin console` in a process of its own."""

    def __init__(self, folder: Path, scene: Path) -> None:
        words = [
            "console",
            "--rig",
            "twin",
            "--scene",
            str(scene),
            "-o",
            str(folder),
            "--no-browser",
            "--port",
            "8790",
        ]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rhizotwin", *words],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert self.process.stdout is not None
        self.address = next(line for line in self.process.stdout if line.startswith("http")).strip()

    def kill(self) -> None:
        """End it without any warning."""
        self.process.kill()
        self.process.communicate()

    def stop(self) -> str:
        """End it as Ctrl-C does; return what it printed."""
        self.process.send_signal(signal.SIGINT)
        printed, _ = self.process.communicate(timeout=PATIENCE_MS / 1000.0)
        return printed


@contextmanager
def opened(browser: Any, address: str, **viewport: int) -> Iterator[Any]:
    """Open a page; an error of its script or a refused resource fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 900, **viewport})
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if "Content Security Policy" in message.text else None)
    page.goto(address)
    page.locator("#activity", has_text="idle").or_(page.locator("#activity.busy")).first.wait_for()
    yield page
    context.close()
    assert not errors


def take_control(page: Any, name: str) -> None:
    page.get_by_label("Your name").fill(name)
    page.locator("#take").click()
    page.get_by_text(f"You ({name}) control the rig").wait_for()


def test_a_scan_survives_the_console(browser: Any, tmp_path: Path) -> None:
    scene = load_scene("sphere_20mm")
    rings = tuple(replace(ring, views=VIEWS) for ring in scene.plan.rings[:1])
    save_scene(replace(scene, camera=scene.camera.resized((400, 300)), plan=CapturePlan(rings=rings)), tmp_path / "scene.toml")
    server = Server(tmp_path / "lab", tmp_path / "scene.toml")
    try:
        with opened(browser, server.address) as page:
            assert "token" not in page.url
            assert page.get_by_role("button", name="Start scan").is_disabled()
            take_control(page, "Anna")
            page.get_by_role("button", name="Check the devices").click()
            page.locator("#devices .dot.ok").nth(6).wait_for()
            page.get_by_label("Plant").fill("P7")
            page.get_by_label("Treatment").fill("low N")
            page.get_by_role("button", name="Start scan").click()
            page.locator("#picture").wait_for()
            page.get_by_role("button", name="Pause").click()
            page.get_by_text("paused with lights, motor and arm switched on").wait_for()
            server.kill()
            page.get_by_text("no connection").wait_for()
        folders = list((tmp_path / "lab" / "scans").iterdir())
        assert len(folders) == 1
        assert len(load_dataset(folders[0]).frames) < VIEWS

        server = Server(tmp_path / "lab", tmp_path / "scene.toml")
        with opened(browser, server.address) as page:
            row = page.locator("#scans tbody tr")
            row.get_by_text("interrupted").wait_for()
            take_control(page, "Ben")
            row.get_by_role("button", name="Finish scan").click()
            page.get_by_text(f"{VIEWS} of {VIEWS} pictures, complete").wait_for()
            row.locator("progress").wait_for()
            with page.expect_popup() as popup:
                row.get_by_role("link", name="Report").click()
            popup.value.get_by_text("ml").first.wait_for()
            assert "P7" in popup.value.content()
            page.get_by_text("Focus", exact=True).wait_for()
            page.get_by_text("Motion", exact=True).wait_for()
        dataset = load_dataset(folders[0])
        assert dataset.origin["complete"]
        assert len(dataset.frames) == VIEWS
        assert dataset.scene.subject.treatment == "low N"
        assert server.stop() is not None
        assert server.process.returncode == 130
    finally:
        server.kill()


def test_two_browsers_see_one_rig(browser: Any, lab: Lab) -> None:
    with opened(browser, lab.served.address) as anna, opened(browser, lab.served.address, width=400) as ben:
        take_control(anna, "Anna")
        ben.get_by_text("Anna has controlled the rig since").wait_for()
        assert ben.get_by_role("button", name="Home").is_disabled()
        anna.locator("form#line input").fill("home 0")
        anna.get_by_role("button", name="Run").click()
        ben.get_by_text("table at 0.000 deg").wait_for()
        take_control(ben, "Ben")
        anna.get_by_text("Ben has controlled the rig since").wait_for()
        assert anna.get_by_role("button", name="Home").is_disabled()
        ben.get_by_role("button", name="+9°").click()
        anna.get_by_text("table at 9.000 deg").wait_for()
        assert ben.evaluate("document.documentElement.scrollWidth") == 400


def test_a_report_is_opened_apart_from_the_console(browser: Any, make_lab: Callable[..., Lab], tmp_path: Path) -> None:
    made = plants.make(tmp_path / "made")
    lab = make_lab()
    shutil.copytree(made.dataset, lab.folder / "scans" / "P7-2026-11-26")
    shutil.copytree(made.result, lab.folder / "results" / "P7-2026-11-26")
    report = lab.folder / "results" / "P7-2026-11-26" / "report.html"
    report.write_text("<script>document.title = 'cookie ' + (() => { try { return document.cookie } catch { return 'apart' } })()</script>")
    with opened(browser, lab.served.address) as page:
        with page.expect_popup() as popup:
            page.get_by_role("link", name="Report").click()
        end = time.monotonic() + PATIENCE_MS / 1000.0
        while popup.value.title() != "cookie apart" and time.monotonic() < end:
            time.sleep(0.05)
        assert popup.value.title() == "cookie apart"


def test_password_in_the_browser(browser: Any, make_lab: Callable[..., Lab]) -> None:
    lab = make_lab("a long password")
    context = browser.new_context()
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"http://127.0.0.1:{lab.served.port}/")
    page.get_by_label("Password").fill("a long password")
    page.get_by_role("button", name="Open the console").click()
    page.locator("#activity", has_text="idle").wait_for()
    context.close()
