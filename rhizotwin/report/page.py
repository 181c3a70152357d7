"""The page of a result, or of many.

The number first, then what it is worth, the shape to turn, the pictures, and everything else.
"""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line
from rhizotwin.corrections.session import read_roots
from rhizotwin.recon.results import assessments, result_traits
from rhizotwin.report import rig_figure, solid, tables, words
from rhizotwin.scenes import atomic, solution, subject, trait_table
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import interval_ml, ml, round_digits
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits
from rhizotwin.simpler import simpler
from rhizotwin.stored import result_files, stored_traits
from rhizotwin.through_water import Pictures

ANGLES_DEG = (0, 45, 90, 135)
"""Directions from which pictures are shown."""
WIDEST_PX = 900
OUTLINE = (255, 120, 0)
MARGIN, LEAST_CUT, LEAST_WIDE_PX = 1.3, 0.2, 480
"""How pictures are cut: so much larger than the roots, at least this share of the picture, at least so wide on the
page."""
OUTLINE_TRIANGLES = 30_000
"""Of a surface whose outline is drawn over pictures."""
CAPTIONS = {
    "lengths.png": "Where the length of the roots is.",
    "shape.png": "The shape from two sides.",
    "shape_and_truth.png": "The reconstructed shape, the true one, and the distance between them, from two sides.",
    "inputs.png": "Pictures above their silhouettes; what a picture says nothing about is tinted red.",
    "cameras.png": "Where the cameras stood; crosses are views that were left out.",
}


@dataclass(frozen=True)
class _Read:
    """A result as the page needs it."""

    folder: Path
    summary: dict[str, Any]
    roots: tuple[Root, ...]
    traits: Traits
    dataset: Dataset | None

    @classmethod
    def of(cls, folder: Path, dataset: Dataset | Path | None) -> _Read:
        summary = result_files.read_summary(folder)
        roots, surface = read_roots(folder), result_files.read_mesh(folder / "shape.ply")
        return cls(folder, summary, roots, stored_traits.of_summary(summary, surface, roots), _dataset(summary, folder, dataset))

    @property
    def name(self) -> str:
        return str(self.summary["scene"])

    @cached_property
    def assessed(self) -> dict[str, Assessment]:
        return assessments.assess(self.summary, self.traits)

    @property
    def subject(self) -> Subject:
        return subject.from_summary(self.summary, str(self.folder / "result.json"))

    @property
    def solution(self) -> str:
        return str(solution.from_summary(self.summary, str(self.folder / "result.json")))


def write(result_folder: Path, *, dataset: Dataset | Path | None = None, output: Path | None = None) -> Path:
    """Write the page of a result, as ``report.html`` in its folder or elsewhere, and return its path.

    Parameters
    ----------
    dataset : Dataset, path or None
        Where the pictures are; None: where the result says, or no pictures where they are gone.

    Raises
    ------
    UserError
        If the result lacks a file, or was made from another dataset than the one given.
    """
    read = _Read.of(Path(result_folder), dataset)
    path = Path(result_folder) / "report.html" if output is None else output
    text = _whole(f"Roots of {read.name}", [_one(read)]).encode("utf-8", "backslashreplace")
    atomic.write_bytes(path, text, follow=output is not None)
    return path


def write_many(result_folders: Sequence[Path], output: Path) -> Path:
    """Write one page for many results, a table of their volumes first."""
    read = [_Read.of(Path(folder), None) for folder in result_folders]
    told = [name for name in subject.NAMES if any(name in one.subject.known for one in read)]
    rows = []
    for place, one in enumerate(read):
        found, interval = words.volume(one.summary)
        state = {"good": "can be used", "fair": "can be used", "bad": "not reliable"}[words.light(one.summary)[0]]
        length = round_digits(one.traits.total_length_mm) if one.traits.total_length_mm else "-"
        if one.traits.total_length_mm and one.assessed["total_length_mm"].verdict != "reliable":
            length += f" ({one.assessed['total_length_mm'].verdict})"
        link = f'<a href="#result-{place}">{html.escape(one.folder.resolve().name)}</a>'
        whose = "".join(f"<td>{html.escape(subject.as_text(one.subject)[name])}</td>" for name in told)
        rows.append(
            f"<tr><td>{link}</td><td>{html.escape(one.name)}</td>{whose}<td class=number>{found}</td><td class=number>{interval}</td>"
            f"<td>{state}</td><td class=number>{length}</td><td>{html.escape(result_traits.describe_edits(one.summary))}</td></tr>"
        )
    names = "".join(f"<th>{name}</th>" for name in ("result", "scene", *told, "volume", "90 % interval", "", "root length (mm)", "edits"))
    head = f"<tr>{names}</tr>"
    table = f"<h1>{len(read)} results</h1><div class=wide><table>{head}{''.join(rows)}</table></div>"
    parts = [f'<div id="result-{place}">{_short(one)}</div>' for place, one in enumerate(read)]
    atomic.write_bytes(output, _whole(f"{len(read)} results", [table, *parts]).encode("utf-8", "backslashreplace"))
    return output


def _whole(title: str, parts: Sequence[str]) -> str:
    here = files("rhizotwin.report")
    style, script = (here.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><link rel="icon" href="data:,">'
        f"<title>{html.escape(title)}</title><style>{style}</style></head><body>{''.join(parts)}<script>{script}</script></body></html>\n"
    )


def _one(read: _Read) -> str:
    """Return all that is told of one result."""
    sections = {
        "Pictures, with the reconstruction's outline drawn as the water bends it": _pictures(read),
        "Plants": _plants(read),
        "Traits": _traits(read),
        "What the interval allows for": _list(words.budget(read.summary)),
        "Where it is and how it looks": _figures(read.folder),
        "How it was made": f"<p>{html.escape(words.method(read.summary, roots=bool(read.roots)))}</p>" + _rig(read),
        "More numbers": _more(read),
    }
    rest = "".join(f"<h2>{title}</h2>{text}" for title, text in sections.items() if text)
    return f"<section data-result>{_head(read)}{_solid(read)}{rest}</section>"


def _short(read: _Read) -> str:
    """Return what is told of one result among many."""
    return f"<section data-result>{_head(read)}{_solid(read)}<details><summary>Traits</summary>{_traits(read)}</details></section>"


def _head(read: _Read) -> str:
    """Return name, number and traffic light."""
    described = "" if read.dataset is None else f"<p class=soft>{html.escape(read.dataset.scene.description)}</p>"
    whose = "; ".join(filter(None, [str(read.subject), read.solution and f"nutrient solution {read.solution}"]))
    described = f"<p>{html.escape(whose)}</p>{described}" if whose else described
    headline, beside = words.headline(read.summary)
    state, meaning, told = words.light(read.summary)
    edits = result_traits.describe_edits(read.summary)
    hand = f"<p class=soft>Corrected by hand: {html.escape(edits)}.</p>" if edits else ""
    return (
        f"<h1>{html.escape(read.name)}</h1>{described}<p class=volume>{headline}</p><p>{beside}</p>{hand}"
        f'<div class="light {state}"><b role="img" aria-label="{state}"></b><div><p><strong>{html.escape(meaning)}</strong></p>'
        f"{_list(told)}</div></div>"
    )


def _solid(read: _Read) -> str:
    """Return the shape to turn, and the files to save."""
    packed = solid.packed(read.roots, read.folder / "shape.ply")
    data = {
        "name": read.name,
        "file": re.sub(r"[^A-Za-z0-9_-]+", "_", read.name) or "result",
        "csv": trait_table.to_csv(read.traits, read.assessed),
        "solid": packed,
    }
    choices: tuple[str, ...] = ("order", "diameter", "depth") if read.roots else ("depth", "plain")
    if "halves" in packed:
        choices += ("uncertainty",)
    options = "".join(f"<option value={choice}>colour by {choice}</option>" for choice in choices)
    saved = ["csv", "stl", *(["rsml"] if read.roots else [])]
    labels = {"csv": "Traits (CSV)", "stl": "Shape as shown (STL)", "rsml": "Centre lines (RSML)"}
    buttons = "".join(f"<button type=button data-file={name}>{labels[name]}</button>" for name in saved)
    return (
        f'<div class=solid><canvas aria-label="the shape, to be turned"></canvas><select aria-label="colour">{options}</select>'
        "<span class=legend></span>"
        "<p>Drag to turn, scroll or pinch to come nearer, Shift to shift.</p></div>"
        f"<p class=downloads>{buttons}<span class=soft>The exact surface is <code>shape.ply</code> in the result's folder.</span></p>"
        f'<script type="application/json">{_inside_script(data)}</script>'
    )


def _inside_script(data: Any) -> str:
    """Return JSON that cannot end the script it stands in."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _pictures(read: _Read) -> str:
    """Return pictures from several sides with the outline of the roots."""
    if read.dataset is None:
        return "<p class=soft>The pictures are not where they were when this page was made.</p>"
    pictures = Pictures.of(read.dataset, read.summary)
    if not pictures.files:
        return ""
    lines = {k: Line(root.points_mm, root.diameters_mm, root.parent, ()) for k, root in enumerate(read.roots)}
    mesh = None if lines else simpler(result_files.read_mesh(read.folder / "shape.ply"), OUTLINE_TRIANGLES)
    around = np.concatenate([root.points_mm for root in read.roots]) if mesh is None else mesh.vertices_mm
    shown, seen = [], set[int]()
    for angle in ANGLES_DEG:
        place = pictures.nearest(float(angle))
        if place in seen:
            continue
        seen.add(place)
        try:
            image = pictures.with_outline(place, mesh, OUTLINE) if mesh else pictures.drawn(place, lines, dict.fromkeys(lines, OUTLINE))
        except UserError:  # a picture that cannot be read any more: the page is made without it
            continue
        scale = image.shape[1] / pictures.views[place].camera.image_wh[0]
        image = _cut(image, scale * (pictures.pixels(place, around[::8]) + 0.5) - 0.5)  # a margin is left about them
        shown.append(_figure(_jpeg(image), f"{angle} degrees: {Path(pictures.files[place]).name}"))
    return f"<div class=pictures>{''.join(shown)}</div>"


def _cut(image: NDArray[np.uint8], pixels: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Cut a picture to what stands in it, in the picture's own proportions, and enlarge what became small.

    A margin is left.
    """
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(seen):
        return image
    high, wide = image.shape[:2]
    middle, half = (seen.min(axis=0) + seen.max(axis=0)) / 2.0, np.ptp(seen, axis=0) / 2.0 * MARGIN
    share = min(1.0, max(2.0 * half[0] / wide, 2.0 * half[1] / high, LEAST_CUT))
    size = np.array([share * wide, share * high])
    corner = np.clip(middle - size / 2.0, 0.0, np.array([wide, high]) - size).astype(int)
    cut = image[corner[1] : corner[1] + int(size[1]), corner[0] : corner[0] + int(size[0])]
    scale = max(1.0, LEAST_WIDE_PX / cut.shape[1])
    return np.asarray(cv2.resize(cut, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8)


def _jpeg(image: Any) -> str:
    if image.shape[1] > WIDEST_PX:
        scale = WIDEST_PX / image.shape[1]
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    stored = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(stored.tobytes()).decode()}"


def _figure(source: str, caption: str) -> str:
    text = html.escape(caption)
    return f'<figure><img alt="{text}" src="{source}"><figcaption>{text}</figcaption></figure>'


def _plants(read: _Read) -> str:
    """Return what is of each of several plants; nothing where there is one."""
    if not read.summary.get("plants"):
        return ""
    from rhizotwin.scenes.neighbours import find_neighbours  # SciPy takes half a second

    rows = []
    for own in result_traits.traits_by_plant(str(read.folder / "result.json"), read.summary, read.traits):
        numbers = [
            "not reliable" if own.assessed[field].verdict == "not reliable" else trait_table.format_number(getattr(own.traits, field))
            for field in ("total_length_mm", "tips", "depth_mm")
        ]
        volume, (low, high) = own.assessed["volume_mm3"], own.assessed["volume_mm3"].interval or (0.0, 0.0)
        known = [f"{ml(own.traits.volume_mm3, half_mm3=0.5 * (high - low))} ml", interval_ml(low, high)]
        rows.append([str(own.subject), *(known if volume.verdict == "reliable" else [volume.verdict, ""]), *numbers])
    head = ("plant", "volume", "90 % interval", "root length (mm)", "tips", "depth (mm)")
    verdict = read.assessed["total_length_mm"].verdict
    pairs = "".join(
        f"<p>{'<br>'.join(html.escape(line.strip()) for line in one.lines(verdict))}</p>" for one in find_neighbours(read.roots)
    )
    return tables.table(rows, head=head, numbers=(1, 2, 3, 4, 5)) + pairs


def _traits(read: _Read) -> str:
    """Return every trait that is one number, with its interval where the result has one, and what it means."""
    rows = []
    for definition in trait_table.DEFINITIONS:
        value = getattr(read.traits, definition.field)
        name, shown, meaning = words.trait(definition, value)
        interval = words.interval(definition, read.assessed[definition.field])
        shown = words.volume(read.summary)[0] if definition.field == "volume_mm3" else shown
        if value is not None:
            rows.append([name, shown, interval, meaning])
    note = "" if read.roots else "<p>No thin roots were found as centre lines, so that lengths, diameters and angles are not known.</p>"
    return note + f"<div class=wide>{tables.table(rows, head=('', '', '90 % interval', 'what it is'), numbers=(1,))}</div>"


def _figures(folder: Path) -> str:
    """Return the pictures of the result's folder."""
    there = [(name, folder / "pictures" / name) for name in CAPTIONS if (folder / "pictures" / name).is_file()]
    return "".join(_figure(f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}", CAPTIONS[name]) for name, path in there)


def _rig(read: _Read) -> str:
    return "" if read.dataset is None else f"<figure class=rig>{rig_figure.svg(read.dataset.scene)}</figure>"


def _more(read: _Read) -> str:
    """Return the tables for those who want to know: calibration, views, provenance."""
    summary = read.summary
    parts = {
        "Sizes": tables.table(_sizes(summary), numbers=(1,)),
        "What the scan calibrated by itself": tables.calibration(summary),
        "Views": tables.views(summary),
        "Settings and versions": tables.table(_provenance(summary)),
    }
    return "".join(f"<details><summary>{name}</summary><div class=wide>{text}</div></details>" for name, text in parts.items() if text)


def _sizes(summary: dict[str, Any]) -> list[tuple[str, str]]:
    extents = [b - a for a, b in zip(summary["extents_min_mm"], summary["extents_max_mm"], strict=True)]
    mu, sigma = summary.get("root_mu_per_mm"), summary.get("root_mu_sigma_per_mm")
    clear = "none: the roots are opaque" if mu is None else f"{mu:.2f} per mm" + ("" if sigma is None else f" ± {sigma:.2f}")
    return [
        ("Root extent (x, y, z)", " x ".join(f"{extent:.1f}" for extent in extents) + " mm"),
        ("Hull before trimming", f"{round_digits(summary['hull_mm3'] / 1000.0)} ml"),
        ("Part of the volume that is hull still", f"{round_digits(summary['untrimmed_mm3'] / 1000.0)} ml"),
        ("Water that too few views could see", f"{round_digits(summary['blind_mm3'] / 1000.0)} ml"),
        ("Light that roots absorb on its way through them", clear),
        ("Views used", f"{sum(view['used'] for view in summary['views'])} of {len(summary['views'])}"),
        ("Computing time", f"{sum(summary['timings_s'].values()):.0f} s"),
    ]


def _provenance(summary: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [("dataset", str(summary.get("dataset", "")))]
    for key, value in summary.get("settings", {}).items():
        rows += [(f"{key}.{name}", str(part)) for name, part in value.items()] if isinstance(value, dict) else [(str(key), str(value))]
    return rows + [(f"version of {key}", str(value)) for key, value in summary.get("versions", {}).items()]


def _list(sentences: Sequence[str]) -> str:
    return "" if not sentences else f"<ul>{''.join(f'<li>{html.escape(sentence)}</li>' for sentence in sentences)}</ul>"


def _dataset(summary: dict[str, Any], folder: Path, given: Dataset | Path | None) -> Dataset | None:
    """Return the dataset; None where it is not where the result says, and nobody gave it."""
    try:
        found = given if isinstance(given, Dataset) else load_dataset(given or Path(str(summary.get("dataset", ""))))
        result_files.check_same_scan(summary["dataset_sha256"], summary["scene"], folder, found)
    except UserError:
        if given is not None:
            raise
        return None
    return found
