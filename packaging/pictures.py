"""Make the pictures of README and docs that show the output of the program, from the current code.

    python packaging/pictures.py
    python packaging/pictures.py --demo my_demo report.jpg viewer.jpg

All pictures show the demonstration, which is computed first (minutes), or taken from the folder of a finished one. The
stamp of a picture is a hash of the files that draw it. The tests compare the stamps with the present files, so that
no picture shows an earlier version.
"""

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "pictures"
STAMPS = FOLDER / "stamps.json"
BROWSERS = "chromium", "chromium-browser", "google-chrome"
FLAGS = "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"
PATIENCE_MS = 300_000
"""Time-out of the browser; rendering without a GPU is slow on a busy computer."""

VIEWS = 24
"""Number of views of the scan in the picture of the console."""
LONG_MM = 30.0
"""Minimum length of the lateral that is selected in the picture of the viewer."""


@cache
def drawn(demo: Path) -> Path:
    """Draw the figures and the report of the demonstration again, and return the report."""
    import rhizotwin as rt

    return Path(rt.write_report(demo / "result", dataset=demo / "dataset", figures="png"))


def figure(demo: Path, goal: Path) -> None:
    """Copy a figure of the demonstration."""
    shutil.copyfile(drawn(demo).parent / "pictures" / goal.name, goal)


def report(demo: Path, goal: Path) -> None:
    """Photograph the top of the report."""
    with browser() as opened:
        shown = opened.new_page(viewport={"width": 1000, "height": 1150})
        shown.goto(drawn(demo).resolve().as_uri())
        shown.locator("canvas[data-drawn]").wait_for(state="attached", timeout=PATIENCE_MS)
        photograph(shown, goal)


def viewer(demo: Path, goal: Path) -> None:
    """Photograph the viewer after a long lateral in front was selected."""
    import rhizotwin as rt

    running = rt.view(demo / "result", demo / "dataset", open_browser=False)
    lines = running._viewer.shown.session.state.lines
    try:
        with browser() as opened:
            shown = opened.new_page(viewport={"width": 1200, "height": 760})
            shown.goto(running.address)
            shown.get_by_role("tab", name="View").wait_for(timeout=PATIENCE_MS)
            laterals = [k for k in lines if lines[k].parent >= 0 and lines[k].length_mm > LONG_MM]
            running._viewer.select_root(max(laterals, key=lambda k: float(lines[k].points_mm[:, 0].mean())))
            running._viewer.wait()
            shown.wait_for_timeout(6000)  # the browser's message about its slow rendering disappears
            photograph(shown, goal)
    finally:
        running.close()


def screencast(_: Path, goal: Path) -> None:
    """Record a screencast of the demonstration, which is computed again."""
    sys.path.insert(0, str(Path(__file__).parent))
    from screencast import write

    write(goal)


def console(_: Path, goal: Path) -> None:
    """Photograph the console during a scan of the emulated rig."""
    from rhizotwin.scenes.files import load_scene, save_scene
    from rhizotwin.scenes.model import CapturePlan

    scene = load_scene("radish_day15a")
    rings = tuple(replace(ring, views=VIEWS) for ring in scene.plan.rings[:1])
    with tempfile.TemporaryDirectory() as temporary, browser() as opened:
        save_scene(replace(scene, camera=scene.camera.resized((800, 600)), plan=CapturePlan(rings=rings)), Path(temporary) / "scene.toml")
        words = ("console", "--rig", "twin", "--scene", "scene.toml", "-o", "lab", "--no-browser")
        started = [sys.executable, "-u", "-m", "rhizotwin", *words]
        with subprocess.Popen(started, cwd=temporary, stdout=subprocess.PIPE, text=True) as process:
            try:
                shown = opened.new_page(viewport={"width": 1280, "height": 1250})
                shown.set_default_timeout(PATIENCE_MS)
                shown.goto(next(line.split()[0] for line in process.stdout or () if line.startswith("http")))
                shown.locator("#take").click()
                shown.get_by_label("Your name").fill("Anna")
                shown.keyboard.press("Enter")
                shown.get_by_role("button", name="Check the devices").click()
                shown.locator("#devices .dot.ok").nth(5).wait_for()  # markers are not visible from every parked position
                for label, text in {"Plant": "R16", "Treatment": "low N"}.items():
                    shown.get_by_label(label, exact=True).fill(text)
                shown.get_by_role("button", name="Start scan").click()
                shown.get_by_text(f"{3 * VIEWS // 4} of {VIEWS} pictures").wait_for()
                write_jpeg(shown.screenshot(), goal)
            finally:
                process.terminate()


@dataclass(frozen=True)
class Picture:
    """Picture of the documentation."""

    make: Callable[[Path, Path], None]
    """Function that makes the picture from the folder of the demonstration."""
    drawn_by: tuple[str, ...]
    """Patterns of the files that draw it."""

    def stamp(self) -> str:
        """Return a hash of the files that draw the picture."""
        total = hashlib.sha256()
        for path in sorted({path for pattern in self.drawn_by for path in (ROOT / "rhizotwin").glob(pattern)}):
            total.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
        return total.hexdigest()[:16]


_FIGURES = "report/figures.py", "report/sides.py", "drawing/*.py"
PICTURES = {
    "inputs.png": Picture(figure, _FIGURES),
    "shape_and_truth.png": Picture(figure, _FIGURES),
    "report.jpg": Picture(report, ("report/*", "drawing/*.py", "scenes/*.css")),
    "console.jpg": Picture(console, ("console/page/*", "scenes/palette.css")),
    "screencast.svg": Picture(screencast, tuple(f"commands/{name}.py" for name in ("scenes", "demo", "traits", "export", "score"))),
    "viewer.jpg": Picture(viewer, ("viewer/*.py", "viewer/page/*", "drawing/*.py", "scenes/palette.css")),
}


def outdated() -> list[str]:
    """Return the names of the pictures that were drawn by other files than the present ones."""
    stored = json.loads(STAMPS.read_text(encoding="utf-8"))
    return [name for name, picture in PICTURES.items() if stored.get(name) != picture.stamp()]


@contextmanager
def browser() -> Iterator[Any]:
    """Provide a running browser."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with sync_playwright() as started:
        opened = started.chromium.launch(executable_path=path, args=list(FLAGS))
        yield opened
        opened.close()


def photograph(shown: Any, goal: Path) -> None:
    """Write a picture of a page as JPEG, after the page has stopped changing."""
    before, now = b"", shown.screenshot(timeout=PATIENCE_MS)
    while now != before:
        shown.wait_for_timeout(1500)
        before, now = now, shown.screenshot(timeout=PATIENCE_MS)
    write_jpeg(now, goal)


def write_jpeg(png: bytes, goal: Path) -> None:
    """Write a picture as JPEG."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    goal.write_bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())


def main(words: Sequence[str]) -> int:
    """Make pictures, and store their stamps."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"pictures to make; default: all ({', '.join(PICTURES)})")
    parser.add_argument("--demo", type=Path, help="folder of a finished demonstration; default: it is computed")
    given = parser.parse_args(words)
    if unknown := [name for name in given.names if name not in PICTURES]:
        parser.error(f"no picture {unknown[0]}; choose from {', '.join(PICTURES)}")
    with tempfile.TemporaryDirectory() as temporary:
        demo = given.demo or Path(temporary) / "demo"
        if given.demo is None:
            subprocess.run([sys.executable, "-m", "rhizotwin", "demo", "-o", str(demo)], cwd=ROOT, check=True)
        for name in given.names or PICTURES:
            PICTURES[name].make(demo, FOLDER / name)
            stored = json.loads(STAMPS.read_text(encoding="utf-8")) if STAMPS.is_file() else {}
            STAMPS.write_text(json.dumps(stored | {name: PICTURES[name].stamp()}, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
