"""Response times of `rhizotwin view` in a real browser with software rendering.

The command is run as by a user, and all measurements use the contents of its page: the time from the command to the
first complete picture, from a click or a drag to the response on the page, the peak memory, the volume after
corrections compared with that of the corrected result measured again, and size and errors of the report.

The processor time of the server alone is measured separately (`benchmarks.viewer_server`).
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks import browser as browsers
from benchmarks import viewer_debris, viewer_server
from benchmarks.browser import PATIENCE_MS
from benchmarks.metric import Metric
from benchmarks.run import Run, Say
from benchmarks.viewer_server import VOXELS
from rhizotwin.scenes.errors import UserError

WINDOW = {"width": 1000, "height": 700}
QUIET_S = 3.0
"""Time without changes after which a picture is complete."""
PHONE_PX = 400
"""Width of the page on a telephone."""
ANSWER_MS = 60_000
"""Time-out of a response."""
PICKS = 5
"""Number of clicks, whose median is reported."""
_VIVID = 90
"""Minimum difference between the strongest and the weakest colour channel of pixels of roots, in contrast to canister
and panels."""
_WATCH = """(() => {
  const frames = []; let parts = new Set(), last = null, most = 0;
  const count = (name, at) => {
    const was = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...a) { parts.add(a[at]); last = this; return was.apply(this, a); };
  };
  count("drawElements", 1); count("drawArrays", 2);
  const after = () => {
    const drawn = [...parts].reduce((a, b) => a + b, 0);  // parts of one size count once, however often a frame is drawn
    if (drawn > 1.02 * most) {
      most = drawn;
      last.readPixels(0, 0, 1, 1, last.RGBA, last.UNSIGNED_BYTE, new Uint8Array(4));  // returns when all of it is drawn
      frames.push([performance.timeOrigin + performance.now(), drawn]);
    }
    parts = new Set();
    requestAnimationFrame(after);
  };
  requestAnimationFrame(after);
  window.bench = { frames, begun: 0, answered: 0, pattern: null, before: "" };
  const said = () => (document.body.textContent.match(window.bench.pattern) || [""])[0];
  window.bench.ask = (pattern) => Object.assign(window.bench, { pattern: new RegExp(pattern), answered: 0 }, { before: "" })
    && (window.bench.before = said());
  addEventListener("pointerup", () => { window.bench.begun = performance.now(); }, true);
  document.addEventListener("DOMContentLoaded", () => new MutationObserver(() => {
    const b = window.bench;
    if (b.pattern && !b.answered && said() !== b.before) b.answered = performance.now();
  }).observe(document.body, { subtree: true, childList: true, characterData: true }));
})()"""
"""Script in the page that records when a frame contains more than any before, and when a text changes after a click."""
_CHOSEN = r"Nothing is selected|Selected: \d+ (root|voxel)s?, [\d.]+ m[ml]"
_CORRECTED = r"as corrected: .*?\d+ mm in \d+ roots|\d+ mm in \d+ roots"


class Page:
    """`rhizotwin view` in its own process, and its page in a browser."""

    def __init__(self, result: Path, dataset: Path | None) -> None:
        self.begun_s = time.time()
        words = [str(result), *([str(dataset)] if dataset else [])]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "rhizotwin", "view", *words, "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.complaints: list[str] = []

    @classmethod
    @contextmanager
    def shown(cls, browser: Any, result: Path, dataset: Path | None) -> Iterator[Page]:
        """Start the command and open its page; the process is ended in any case.

        Parameters
        ----------
        browser : Browser
            Playwright browser.
        result : Path
            Folder of the result.
        dataset : Path or None
            Folder of its pictures; None if there are none.

        Returns
        -------
        iterator of Page
            The page.
        """
        page = cls(result, dataset)
        try:
            page.show(browser)
            yield page
        finally:
            if page._process.returncode is None:
                page._process.kill()
                page._process.wait()

    def show(self, browser: Any) -> None:
        """Open the page as soon as the command prints its address."""
        assert self._process.stdout is not None
        address = self._process.stdout.readline().strip()
        self.served_s = time.time() - self.begun_s
        if not address.startswith("http"):
            self._process.kill()
            raise UserError(f"`rhizotwin view` served nothing: {self._process.communicate()[1].strip()}")
        self.page = browser.new_page(viewport=WINDOW)
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else None)
        self.page.add_init_script(_WATCH)
        self.page.goto(address)

    def first_picture_s(self) -> float:
        """Wait until the picture is complete, and return the time since the command."""
        until = time.monotonic() + PATIENCE_MS / 1000.0
        while time.monotonic() < until:
            frames = self.page.evaluate("bench.frames")
            if frames and time.time() - frames[-1][0] / 1000.0 > QUIET_S:
                return float(frames[-1][0] / 1000.0 - self.begun_s)
            time.sleep(0.2)
        raise UserError("the page drew no picture")

    def asked(self, pattern: str, act: Any) -> float:
        """Return the seconds from the end of a click until the text that matches a pattern changes."""
        self.page.evaluate("pattern => bench.ask(pattern)", pattern)
        act()
        self.page.wait_for_function("bench.answered > 0", timeout=ANSWER_MS)
        return float(self.page.evaluate("bench.answered - bench.begun")) / 1000.0

    def press(self, name: str) -> None:
        """Click a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def layer(self, name: str, *, on: bool) -> None:
        """Switch a layer on or off."""
        self.page.get_by_role("tab", name="View").click()
        box = self.page.get_by_label(name)
        if box.is_checked() != on:
            box.click()

    def says(self, pattern: str) -> str:
        """Return the text of the page that matches a pattern; empty if there is none."""
        found = re.search(pattern, self.page.evaluate("document.body.textContent"))
        return "" if found is None else found[0]

    def end(self) -> tuple[float, float]:
        """End the command; return its peak memory (MiB) and its processor time (s)."""
        self.page.close()
        self._process.send_signal(signal.SIGINT)
        _, _, used = os.wait4(self._process.pid, 0)
        self._process.returncode = 0
        return used.ru_maxrss / 1024.0, used.ru_utime + used.ru_stime


def measure(results: Sequence[Path], dataset: Path | None, *, clean: Path | None, repeats: int, say: Say) -> Run:
    """Measure the viewer and the report of results; a failure is recorded, and the rest continue.

    Parameters
    ----------
    results : sequence of Path
        Folders of the results.
    dataset : Path or None
        Folder of their pictures; None if there are none.
    clean : Path or None
        Result of a scan without debris; additional roots of the others are removed by clicks.
    repeats : int
        Number of measurements, whose median is used.
    say : Say
        Receives every number.

    Returns
    -------
    Run
        Times, memory, and failures.
    """
    run = Run()
    with browsers.chromium() as browser:
        from playwright.sync_api import Error as BrowserError

        browser.new_page().close()  # a user's browser is already running
        for result in results:
            try:
                found = _of_result(browser, result, dataset, repeats=repeats, say=say)
                if clean is not None:
                    found |= viewer_debris.measure(browser, result, clean, dataset or _dataset(result), window=WINDOW)
            except (UserError, BrowserError) as error:
                run.crashed[result.name] = str(error)
                say(f"{result.name}: FAILED\n{error}")
                continue
            for name, (value, unit) in found.items():
                run.metrics.append(Metric(key=f"view/{result.name}/{name}", value=value, unit=unit, direction="down"))
    return run


def _of_result(browser: Any, result: Path, dataset: Path | None, *, repeats: int, say: Say) -> dict[str, tuple[float, str]]:
    """Return the numbers of one result with their units."""
    found: dict[str, tuple[float, str]] = {}
    with tempfile.TemporaryDirectory(prefix="rhizotwin-benchmark-") as working:
        copy = Path(working) / result.name
        shutil.copytree(result, copy)  # corrections are saved beside the copy
        dataset = dataset or _dataset(result)
        times, served = [], []
        for number in range(repeats):
            with Page.shown(browser, copy, dataset) as page:
                times.append(page.first_picture_s())
                served.append(page.served_s)
                load = os.getloadavg()[0]
                say(f"{result.name}: first picture after {times[-1]:.2f} s, address after {served[-1]:.2f} s; load {load:.1f}")
                if number + 1 == repeats:
                    found |= viewer_server.measure(copy, dataset)
                    found |= _measure_edits(page)
                    if page.says(_CORRECTED).startswith("as corrected"):
                        page.press("Save corrections (Ctrl+S)")
                        page.page.get_by_text("edits.json").first.wait_for()
                        found["volume_against_afresh"] = _volume_difference(copy, Path(working) / "corrected"), "1"
                memory, cpu = page.end()
        found |= {"first_picture": (statistics.median(times), "s"), "address": (statistics.median(served), "s")}
        found |= {"peak_memory": (memory, "MiB"), "processor_time": (cpu, "s"), "console_errors": (float(len(page.complaints)), "1")}
        found |= _report(browser, copy, dataset)
    say(f"{result.name}: " + _format_numbers(found))
    return found


def _format_numbers(found: dict[str, tuple[float, str]]) -> str:
    return ", ".join(f"{name} {value:.3g} {unit}".removesuffix(" 1") for name, (value, unit) in found.items())


def _measure_edits(page: Page) -> dict[str, tuple[float, str]]:
    """Select and delete as a user does; return the response times of the page."""
    found: dict[str, tuple[float, str]] = {}
    if page.says(r"\d+ mm in [1-9]\d* roots"):
        page.page.get_by_role("tab", name="Edit").click()
        page.page.get_by_text("Nothing is selected").wait_for()
        spots = _vivid(page)
        times = []
        for x, y in spots[:PICKS]:
            times.append(page.asked(_CHOSEN, lambda x=x, y=y: page.page.mouse.click(x, y)))
            if len(times) < PICKS:
                page.asked(_CHOSEN, lambda: page.press("Deselect (Esc)"))
        found["pick"] = statistics.median(times), "s"
        found["pick_worst"] = max(times), "s"
        found["delete_root"] = page.asked(_CORRECTED, lambda: page.press("Delete (Del)")), "s"
        found["undo"] = page.asked(_CORRECTED, lambda: page.press("Undo (Ctrl+Z)")), "s"
        page.asked(_CORRECTED, lambda: page.press("Redo (Ctrl+Y)"))
    page.layer("Surface", on=False)  # it hides the voxels, and is updated after the number
    page.layer("Voxels", on=True)
    page.page.get_by_role("tab", name="Edit").click()
    found["voxels"], found["choose_voxels"] = _drag(page)
    if found["voxels"][0]:
        found["delete_voxels"] = page.asked(_CORRECTED, lambda: page.press("Delete (Del)")), "s"
    return found


def _shot(page: Page) -> NDArray[np.int64]:
    """Return a screenshot of the page (H, W, 3)."""
    shot = page.page.screenshot(timeout=PATIENCE_MS)
    return np.asarray(cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR), np.int64)


def _vivid(page: Page) -> list[tuple[int, int]]:
    """Return distant positions (x, y) of the scene at which roots are visible."""
    page.page.wait_for_timeout(1000)
    image = _shot(page)
    vivid = np.asarray(np.ptp(image, axis=2) > _VIVID, np.uint8)
    vivid[:, int(0.6 * image.shape[1]) :] = 0  # the panel
    vivid[: int(0.3 * image.shape[0])] = 0  # the browser's message about software rendering
    inside = cv2.erode(vivid, np.ones((3, 3), np.uint8))
    y, x = np.nonzero(inside if inside.any() else vivid)
    if not len(x):
        raise UserError("the page shows no roots to click")
    places = np.unique(np.linspace(0, len(x) - 1, PICKS).astype(int))
    return [(int(x[k]), int(y[k])) for k in places]


def _drag(page: Page) -> tuple[tuple[float, str], tuple[float, str]]:
    """Draw increasingly large rectangles until one selects 1,000 voxels, or all.

    Returns
    -------
    count, answer : tuple of float and str
        Number of voxels and response time, with their units.
    """
    from playwright.sync_api import TimeoutError as LateError

    count, taken, held = 0, 0.0, ""
    for half in (15, 30, 60, 120, 240):
        x, y = 0.35 * WINDOW["width"], 0.55 * WINDOW["height"]

        def drag(x: float = x, y: float = y, half: int = half) -> None:
            mouse, keys = page.page.mouse, page.page.keyboard
            keys.down("Shift")
            mouse.move(x - half, y - half)
            mouse.down()
            mouse.move(x, y)
            mouse.move(x + half, min(y + half, WINDOW["height"] - 5))
            mouse.up()
            keys.up("Shift")

        page.page.evaluate("pattern => bench.ask(pattern)", _CHOSEN)
        drag()
        try:
            page.page.wait_for_function("bench.answered > 0", timeout=10_000)
        except LateError:
            continue  # nothing is visible there
        taken = float(page.page.evaluate("bench.answered - bench.begun")) / 1000.0
        held = page.says(r"\d+ voxels?")
        count = int(held.split()[0]) if held else 0
        if count >= VOXELS:
            break
    return (float(count), "1"), (taken, "s")


def _volume_difference(result: Path, corrected: Path) -> float:
    """Return the difference between the corrected volume and that of the corrected result measured again."""
    from rhizotwin.corrections import corrected as folders
    from rhizotwin.corrections.session import Session
    from rhizotwin.stored import result_files

    session = Session(result)
    before = session.measure().volume_mm3
    folders.write(session, corrected)
    leaves = result_files.read_leaves(corrected)
    stored = float((leaves.occupancy.astype(np.float64) * (leaves.size * leaves.voxel_mm) ** 3).sum())
    return max(abs(stored / before - 1.0), abs(Session(corrected).measure().volume_mm3 / before - 1.0))


def _report(browser: Any, result: Path, dataset: Path | None) -> dict[str, tuple[float, str]]:
    """Return size, width and errors of the self-contained page, read from disk without a network."""
    from rhizotwin.report import page

    path = page.write(result, dataset=dataset)
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": PHONE_PX, "height": 800}, offline=True)
    shown = context.new_page()
    shown.on("console", lambda message: complaints.append(message.text) if message.type in ("error", "warning") else None)
    shown.on("pageerror", lambda error: complaints.append(str(error)))
    shown.goto(path.as_uri())
    # by its attribute: a polled function is rejected by the page's content security policy, which forbids eval
    shown.locator("canvas[data-drawn]:not([data-drawn='0'])").wait_for(state="attached", timeout=PATIENCE_MS)
    wide = float(shown.evaluate("document.documentElement.scrollWidth"))
    context.close()
    return {
        "report_size": (path.stat().st_size / 1e6, "MB"),
        "report_width_on_phone": (wide, "px"),
        "report_complaints": (float(len(complaints)), "1"),
    }


def _dataset(result: Path) -> Path | None:
    """Return the folder of a result's pictures, if it exists."""
    from rhizotwin.stored import result_files

    folder = Path(str(result_files.read_summary(result)["dataset"]))
    return folder if (folder / "dataset.json").is_file() else None
