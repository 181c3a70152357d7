#!/bin/sh
# viser 1.1.1: the hint of a button, "optional hint to display on hover", is never shown; that of a slider is.
# Needs Chromium on the PATH.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet viser==1.1.1 playwright==1.65.2
"$folder/venv/bin/python" - <<'PYTHON'
import shutil
from importlib.metadata import version

import viser
from playwright.sync_api import sync_playwright

server = viser.ViserServer(host="127.0.0.1", port=8731, verbose=False)
server.gui.add_button("Measure", hint="hint of the button")
server.gui.add_slider("Radius", 0.0, 1.0, 0.1, 0.5, hint="hint of the slider")
with sync_playwright() as started:
    browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    page = browser.new_page()
    page.goto(f"http://127.0.0.1:{server.get_port()}")
    shown = {}
    for role, hint in (("slider", "hint of the slider"), ("button", "hint of the button")):
        control = page.locator("[role=slider]") if role == "slider" else page.get_by_role("button", name="Measure")
        control.hover(timeout=60_000)
        page.wait_for_timeout(3_000)
        shown[role] = hint in page.content()
    browser.close()
server.stop()
print(f"viser {version('viser')}: hint shown on hover: slider {shown['slider']}, button {shown['button']}")
assert shown == {"slider": True, "button": False}, "the hints of buttons are shown now"
PYTHON
