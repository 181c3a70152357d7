"""Record a screencast from the running program: commands, what they print and when, the picture at the end.

It runs the `rhizotwin` of the environment it is called with, in a new folder, and writes an SVG that CSS animates: no
script, nothing loaded from elsewhere, nothing cut or sped up. `pictures.py` calls it.
"""

import base64
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from html import escape
from pathlib import Path

import cv2

COMMANDS = (
    "rhizotwin scenes",
    "rhizotwin demo",
    "rhizotwin traits demo/result",
    "rhizotwin export demo/result -o root.stl",
    "rhizotwin score demo/result demo/dataset",
)
PICTURE = "demo/result/pictures/shape_and_truth.png"
ENVIRONMENT = "my_environment"
"""Shown in place of the environment's folder, which is nobody's business."""
KEY_S = 0.06
"""Between two typed letters: 200 words a minute."""
READ_S = 6.0
"""After each command, for the reader."""
PICTURE_S = 30.0
COLUMNS, ROWS = 110, 30
LETTER_WH = (8.0, 17.0)
"""Of a monospaced font of 13 pixels."""


@dataclass(frozen=True)
class Line:
    """A line of the terminal."""

    at_s: float
    text: str
    typed: bool = False


def record(folder: Path) -> tuple[list[Line], float]:
    """Run the commands in a folder; return the lines with their times, and when the last command was over."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "PYTHONUNBUFFERED": "1"}
    lines: list[Line] = []
    now = 1.0
    for command in COMMANDS:
        lines.append(Line(now, f"$ {command}", typed=True))
        now += KEY_S * len(command)
        begin = time.monotonic()
        with subprocess.Popen(
            command.split(), cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8"
        ) as running:
            for text in running.stdout or ():
                lines += [
                    Line(now + time.monotonic() - begin, part) for part in wrapped(text.rstrip("\n").replace(sys.prefix, ENVIRONMENT))
                ]
        if running.returncode:
            raise SystemExit(f"screencast: `{command}` ended with exit code {running.returncode}")
        now += time.monotonic() - begin + READ_S
    return lines, now


def wrapped(text: str) -> list[str]:
    """Return a line of text as lines that fit."""
    return [text[at : at + COLUMNS] for at in range(0, len(text), COLUMNS)] or [""]


def draw(lines: list[Line], end_s: float, picture: Path) -> str:
    """Return the SVG: each line appears at its time, and all move up when the last one leaves the window."""
    letter, row = LETTER_WH
    width, height = COLUMNS * letter + 20.0, ROWS * row + 20.0
    drawn, moves = [], []
    for k, line in enumerate(lines):
        style = f"animation-delay:{line.at_s:.2f}s"
        kind = "typed" if line.typed else "said"
        place = f'x="10" y="{(k + 1) * row + 5:.0f}" xml:space="preserve"'
        drawn.append(f'<text class="{kind}" style="{style}" {place}>{escape(line.text)}</text>')
        if k >= ROWS:
            moves.append(f"{100 * line.at_s / (end_s + PICTURE_S):.3f}%{{transform:translateY({-(k + 1 - ROWS) * row:.0f}px)}}")
    image = cv2.imread(str(picture))
    size = cv2.resize(image, (900, round(900 * image.shape[0] / image.shape[1])), interpolation=cv2.INTER_AREA)
    data = base64.b64encode(cv2.imencode(".jpg", size, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()).decode()
    style = (
        "text{font:13px monospace;fill:#ddd;opacity:0;animation:show 1ms forwards}.typed{fill:#8f8;font-weight:bold}"
        "@keyframes show{to{opacity:1}}@keyframes up{0%{transform:none}" + "".join(moves) + "}"
        f"#lines{{animation:up {end_s + PICTURE_S:.0f}s step-end forwards}}"
        f"#picture{{opacity:0;animation:show 1s forwards;animation-delay:{end_s:.1f}s}}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}">'
        f'<style>{style}</style><rect width="100%" height="100%" fill="#222"/><g id="lines">{"".join(drawn)}</g>'
        f'<image id="picture" x="0" y="0" width="{width:.0f}" height="{height:.0f}" href="data:image/jpeg;base64,{data}"/></svg>\n'
    )


def write(goal: Path) -> None:
    """Record the commands, and write the screencast."""
    with tempfile.TemporaryDirectory() as folder:
        lines, end_s = record(Path(folder))
        goal.write_text(draw(lines, end_s, Path(folder) / PICTURE), encoding="utf-8")
