"""HTML report of one or many results: volume and verdict, shape in 3D, pictures, traits and details."""

from __future__ import annotations

import base64
import gzip
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

from rhizotwin import surface_mesh
from rhizotwin.corrections.lines import as_lines
from rhizotwin.recon.results import assessments, result_traits
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.report import rig_figure, shape_data, tables, words
from rhizotwin.scenes import atomic, solution, subject, trait_table
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import interval_ml, ml, round_digits
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files, result_names, stored_traits
from rhizotwin.through_water import THIN_MM, Pictures

AZIMUTHS_DEG = (0, 45, 90, 135)
"""Azimuths of the pictures in a report, deg."""
WIDEST_PX = 900
"""Maximum width of a picture in a report, pixels."""
TRIANGLES, TRIANGLES_OF_MANY = 80_000, 24_000
"""Maximum numbers of surface triangles in a report of one result (about 1.7 MB) and in a report of many results."""
MARGIN, SMALLEST_PART, LEAST_WIDE_PX = 1.3, 0.2, 480
"""Parameters for cropping a picture: size of the crop relative to the extent of the roots, minimum size as a fraction
of the picture, and minimum width, px. Narrower crops are enlarged."""
CAPTIONS = {
    "lengths.png": "Root length by depth, diameter and order.",
    "shape.png": "Reconstructed surface from two sides.",
    "shape_and_truth.png": "Reconstructed surface, true surface, and the distance between them, from two sides.",
    "inputs.png": "Pictures (top) and silhouettes (bottom). Red: pixels without information about the roots.",
    "cameras.png": "Camera positions. Crosses: unused views.",
}
"""Captions of the figures in a result's folder, keyed by file name."""


@dataclass(frozen=True)
class _Report:
    """Result with all data that a report needs."""

    folder: Path
    summary: dict[str, Any]
    roots: tuple[Root, ...]
    surface: Mesh
    traits: Traits
    dataset: Dataset | None

    @classmethod
    def read(cls, folder: Path, dataset: Dataset | Path | None) -> _Report:
        summary = result_files.read_summary(folder)
        roots, surface = result_files.read_roots(folder), result_files.read_mesh(folder / "shape.ply")
        traits = stored_traits.of_summary(summary, surface, roots)
        return cls(folder, summary, roots, surface, traits, result_files.find_dataset(folder, summary, dataset))

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
    """Write the report of a result to an HTML file and return the file's path.

    Parameters
    ----------
    result_folder : Path
        Result folder.
    dataset : Dataset, path or None
        Dataset of the result. None: the dataset recorded in the result. If the recorded dataset does not exist, the
        report contains no pictures.
    output : path or None
        Output file. None: ``report.html`` in the result folder.

    Raises
    ------
    UserError
        If a file of the result is missing, or the given dataset is not that of the result.
    """
    report = _Report.read(Path(result_folder), dataset)
    path = Path(result_folder) / "report.html" if output is None else output
    text = _document(f"Roots of {report.name}", [_full_report(report)]).encode("utf-8", "backslashreplace")
    atomic.write_bytes(path, text, follow=output is not None)
    return path


def write_many(result_folders: Sequence[Path], output: Path) -> Path:
    """Write a single report of many results, beginning with a table of their volumes, and return its path."""
    reports = [_Report.read(Path(folder), None) for folder in result_folders]
    usable = sum(bool(one.summary["volume_trusted"]) for one in reports)
    known = [name for name in subject.NAMES if any(name in one.subject.known for one in reports)]
    head = ["verdict", "volume (90 % interval)", "result", *("scene", *known, "root length (mm)", "edits")]
    cells = "".join(f"<th{' class=more' if k > 2 else ''}>{html.escape(name)}</th>" for k, name in enumerate(head))
    names = result_names.names_of([one.folder for one in reports])
    rows = "".join(_row(place, name, one, known) for place, (name, one) in enumerate(zip(names, reports, strict=True)))
    title = f"{usable} of {len(reports)} volumes usable"
    table = f"<h1>{title}</h1><div class=wide><table class=overview><tr>{cells}</tr>{rows}</table></div>"
    parts = [f'<div id="result-{place}">{_short_report(one)}</div>' for place, one in enumerate(reports)]
    atomic.write_bytes(output, _document(title, [table, *parts]).encode("utf-8", "backslashreplace"))
    return output


def _row(place: int, name: str, report: _Report, known: Sequence[str]) -> str:
    """Return the row of a result in the table of volumes."""
    length, interval = report.traits.total_length_mm, report.assessed["total_length_mm"]
    shown = "-" if not length else round_digits(length) + ("" if interval.verdict == "reliable" else f" ({interval.verdict})")
    link = f'<a href="#result-{place}">{html.escape(name)}</a>'
    more = [report.name, *(subject.as_text(report.subject)[key] for key in known), shown, result_traits.describe_edits(report.summary)]
    return (
        f"<tr>{tables.verdict_cells(report.summary)}<td>{link}</td>"
        f"{''.join(f'<td class=more>{html.escape(text)}</td>' for text in more)}</tr>"
    )


def _document(title: str, parts: Sequence[str]) -> str:
    here = files("rhizotwin.report")
    style, script = (here.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><link rel="icon" href="data:,">'
        f"<title>{html.escape(title)}</title><style>{style}</style></head><body>{''.join(parts)}<script>{script}</script></body></html>\n"
    )


def _full_report(report: _Report) -> str:
    """Return the report of one result as an HTML section."""
    surface = surface_mesh.simplify(surface_mesh.close(report.surface), TRIANGLES)
    method = words.methods_paragraph(report.summary, roots=bool(report.roots), simulated=words.is_simulated(report.dataset))
    sections = {
        "Pictures with the outline of the reconstruction": _pictures(report, surface),
        "Plants": _plants(report),
        "Traits": _traits(report),
        "Causes of uncertainty": _list(words.uncertainty_causes(report.summary)),
        "Figures": _figures(report.folder),
        "Methods": f"<p>{html.escape(method)}</p>" + _rig(report),
        "Details": _details(report),
    }
    rest = "".join(f"<h2>{title}</h2>{text}" for title, text in sections.items() if text)
    return f"<section data-result>{_head(report)}{_shape(report, surface)}{rest}</section>"


def _short_report(report: _Report) -> str:
    """Return the short report of one of many results as an HTML section."""
    shape = _shape(report, surface_mesh.simplify(surface_mesh.close(report.surface), TRIANGLES_OF_MANY))
    return f"<section data-result>{_head(report)}{shape}<details><summary>Traits</summary>{_traits(report)}</details></section>"


def _head(report: _Report) -> str:
    """Return the heading of a report as HTML: name, subject, volume, and the verdict as a traffic light."""
    scan = "Simulated scan" if words.is_simulated(report.dataset) else "Scan"
    described = "" if report.dataset is None else ": ".join(filter(None, [scan, report.dataset.scene.description]))
    described = f"<p class=soft>{html.escape(described)}</p>" if described else ""
    whose = "; ".join(filter(None, [str(report.subject), report.solution and f"nutrient solution {report.solution}"]))
    described = f"<p>{html.escape(whose)}</p>{described}" if whose else described
    headline, beside = words.headline(report.summary)
    state, meaning, advice = words.traffic_light(report.summary)
    edits = result_traits.describe_edits(report.summary)
    by_hand = f"<p class=soft>Edited by hand: {html.escape(edits)}.</p>" if edits else ""
    return (
        f"<h1>{html.escape(report.name)}</h1>{described}<p class=volume>{headline}</p><p>{beside}</p>{by_hand}"
        f'<div class="light {state}"><b role="img" aria-label="{state}"></b><div><p><strong>{html.escape(meaning)}</strong></p>'
        f"{_list(advice)}</div></div>"
    )


def _shape(report: _Report, surface: Mesh) -> str:
    """Return the canvas that shows the shape in 3D, and the buttons that save files, as HTML."""
    packed = shape_data.pack_shape(surface, report.roots)
    data = {
        "file": re.sub(r"[^A-Za-z0-9_-]+", "_", report.name) or "result",
        "csv": trait_table.to_csv(report.traits, report.assessed),
        "shape": packed,
    }
    if report.roots:
        data["rsml"] = base64.b64encode(gzip.compress((report.folder / "roots.rsml").read_bytes(), mtime=0)).decode()
    options = "".join(f"<option value={by}>colour by {by}</option>" for by in packed["keys"]) + "<option value=plain>one colour</option>"
    saved = ["csv", "stl", "glb", *(["rsml"] if report.roots else [])]
    labels = {"csv": "Traits (CSV)", "stl": "Surface (STL)", "glb": "Surface with colours (GLB)", "rsml": "Centre lines (RSML)"}
    buttons = "".join(f"<button type=button data-file={name}>{labels[name]}</button>" for name in saved)
    mean_mm = report.traits.mean_diameter_mm
    checked = " checked" if mean_mm is not None and mean_mm < THIN_MM else ""  # because the surface of thin roots has gaps
    overlay = f"<label><input type=checkbox{checked}> centre lines</label>" if report.roots else ""
    return (
        f'<div class=solid><canvas aria-label="3D view of the shape"></canvas><div class=controls><div><select aria-label="colour">'
        f"{options}</select>{overlay}<button type=button>reset view</button></div><div class=key></div></div>"
        "<div class=below><p>Drag to rotate, scroll or pinch to zoom, Shift and drag to pan.</p><div class=bar></div></div></div>"
        f"<p class=downloads>{buttons}<span class=soft>STL and GLB: closed surface with fewer triangles; the original is "
        "<code>shape.ply</code> in the result's folder.</span></p>"
        f'<script type="application/json">{_inside_script(data)}</script>'
    )


def _inside_script(data: Any) -> str:
    """Return data as JSON text without characters that could end the script element."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _pictures(report: _Report, surface: Mesh) -> str:
    """Return pictures from several directions with the outline of the reconstruction, as HTML."""
    if report.dataset is None:
        return "<p class=soft>The dataset was not found when this report was written.</p>"
    pictures = Pictures.of(report.dataset, report.summary)
    if not pictures.files:
        return ""
    lines = as_lines(report.roots)
    around = np.concatenate([surface.vertices_mm, *(root.points_mm for root in report.roots)])
    shown, used = [], set[int]()
    for angle in AZIMUTHS_DEG:
        place = pictures.nearest(float(angle))
        if place in used:
            continue
        used.add(place)
        try:
            image = pictures.draw_outline(place, surface, lines)
        except UserError:  # a picture that cannot be read is omitted from the report
            continue
        scale = image.shape[1] / pictures.views[place].camera.image_wh[0]
        image = _crop(image, scale * (pictures.pixels(place, around[::8]) + 0.5) - 0.5)
        shown.append(_figure(_jpeg(image), f"{angle} degrees: {Path(pictures.files[place]).name}"))
    return f"<div class=pictures>{''.join(shown)}</div>"


def _crop(image: NDArray[np.uint8], pixels: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Crop a picture around projected points (N, 2), in pixels, with a margin.

    The crop has the aspect ratio of the picture. Small crops are enlarged.
    """
    inside = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(inside):
        return image
    high, wide = image.shape[:2]
    middle, half = (inside.min(axis=0) + inside.max(axis=0)) / 2.0, np.ptp(inside, axis=0) / 2.0 * MARGIN
    share = min(1.0, max(2.0 * half[0] / wide, 2.0 * half[1] / high, SMALLEST_PART))
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


def _plants(report: _Report) -> str:
    """Return a table with the traits of each plant as HTML. It is empty for a single plant."""
    if not report.summary.get("plants"):
        return ""
    from rhizotwin.scenes.neighbours import find_neighbours  # SciPy takes half a second to load

    rows = []
    for own in result_traits.traits_by_plant(str(report.folder / "result.json"), report.summary, report.traits):
        numbers = [
            "not reliable" if own.assessed[field].verdict == "not reliable" else trait_table.format_number(getattr(own.traits, field))
            for field in ("total_length_mm", "tips", "depth_mm")
        ]
        volume, (low, high) = own.assessed["volume_mm3"], own.assessed["volume_mm3"].interval or (0.0, 0.0)
        known = [f"{ml(own.traits.volume_mm3, half_mm3=0.5 * (high - low))} ml", interval_ml(low, high)]
        rows.append([str(own.subject), *(known if volume.verdict == "reliable" else [volume.verdict, ""]), *numbers])
    head = ("plant", "volume", "90 % interval", "root length (mm)", "tips", "depth (mm)")
    verdict = report.assessed["total_length_mm"].verdict
    pairs = "".join(
        f"<p>{'<br>'.join(html.escape(line.strip()) for line in one.lines(verdict))}</p>" for one in find_neighbours(report.roots)
    )
    return tables.table(rows, head=head, numbers=(1, 2, 3, 4, 5)) + pairs


def _traits(report: _Report) -> str:
    """Return a table of all scalar traits with their 90 % intervals and definitions, as HTML."""
    values = ((definition, getattr(report.traits, definition.field)) for definition in trait_table.DEFINITIONS)
    rows = [words.trait_text(definition, value, report.assessed[definition.field]) for definition, value in values if value is not None]
    missing = "<p>No centre lines were found, so that lengths, diameters and angles are not available.</p>"
    head = ("trait", "value", "90 % interval", "definition")
    return ("" if report.roots else missing) + f'<div class="wide traits">{tables.table(rows, head=head, numbers=(1,))}</div>'


def _figures(folder: Path) -> str:
    """Return the figures in the result's folder as HTML."""
    there = [(name, folder / "pictures" / name) for name in CAPTIONS if (folder / "pictures" / name).is_file()]
    return "".join(_figure(f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}", CAPTIONS[name]) for name, path in there)


def _rig(report: _Report) -> str:
    return "" if report.dataset is None else f"<figure class=rig>{rig_figure.svg(report.dataset.scene)}</figure>"


def _details(report: _Report) -> str:
    """Return tables of sizes, calibration, views and settings as HTML."""
    summary = report.summary
    parts = {
        "Sizes": tables.table(_sizes(summary), numbers=(1,)),
        "Self-calibration": tables.calibration(summary),
        "Views": tables.views(summary),
        "Settings and versions": tables.table(_provenance(summary)),
    }
    return "".join(f"<details><summary>{name}</summary><div class=wide>{text}</div></details>" for name, text in parts.items() if text)


def _sizes(summary: dict[str, Any]) -> list[tuple[str, str]]:
    extents = [b - a for a, b in zip(summary["extents_min_mm"], summary["extents_max_mm"], strict=True)]
    mu, sigma = summary.get("root_mu_per_mm"), summary.get("root_mu_sigma_per_mm")
    attenuation = "opaque" if mu is None else f"{mu:.2f} per mm" + ("" if sigma is None else f" ± {sigma:.2f}")
    return [
        ("Root extent (x, y, z)", " x ".join(f"{extent:.1f}" for extent in extents) + " mm"),
        ("Hull before trimming", f"{round_digits(summary['hull_mm3'] / 1000.0)} ml"),
        ("Volume of hull that could not be trimmed", f"{round_digits(summary['untrimmed_mm3'] / 1000.0)} ml"),
        ("Water visible in too few views", f"{round_digits(summary['blind_mm3'] / 1000.0)} ml"),
        ("Attenuation of light in roots", attenuation),
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
