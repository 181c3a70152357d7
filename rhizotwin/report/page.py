"""HTML report of one or many results: verdict, shape in 3D, pictures, traits and details."""

from __future__ import annotations

import base64
import gzip
import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import as_lines
from rhizotwin.drawing import root_colours
from rhizotwin.drawing.through_water import THIN_MM, Pictures
from rhizotwin.recon.results import result_traits
from rhizotwin.report import charts, rig_figure, shape_data, sides, tables, words
from rhizotwin.report.report_data import ReportData
from rhizotwin.scenes import atomic, html_page, subject, trait_table
from rhizotwin.scenes.assessment import Assessment, reasons
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import interval_ml, ml, round_digits
from rhizotwin.scenes.html_page import Markup, escape, figure, items, table
from rhizotwin.scenes.monitor import threads
from rhizotwin.scenes.traits import DEPTH_BIN_MM, DIAMETER_BIN_MM
from rhizotwin.stored import result_names

AZIMUTHS_DEG = {"front": 0.0, "side": -90.0}
"""Azimuths of the pictures in a report, deg: those of the renderings, see `shading.FRONT` and `shading.SIDE`."""
MOST_AT_ONCE = 4
"""Maximum number of shapes that are drawn at the same time. A plant of day 30 needs 0.3 GB of memory."""
WIDEST_PX = 900
"""Maximum width of a picture in a report, pixels."""
MARGIN, SMALLEST_PART, LEAST_WIDE_PX = 1.3, 0.2, 480
"""Parameters for cropping a picture: size of the crop relative to the extent of the roots, minimum size as a fraction
of the picture, and minimum width, px. Narrower crops are enlarged."""
CAPTIONS = {
    "inputs.png": "Pictures (top) and silhouettes (bottom). Grey: pixels without information about the roots.",
    "shape_and_truth.png": "Reconstructed surface, true surface, and the distance between them, from two sides.",
}
"""Captions of the figures in a result's folder, keyed by file name. Reports show those that were drawn."""
SAVED = {
    "csv": "traits",
    "rsml": "centre lines",
    "stl": "closed surface with fewer triangles than shape.ply",
    "glb": "closed surface with colours, with fewer triangles than shape.ply",
}
"""Contents of the files that a report can save, keyed by file type."""


def write(result: Path | ReportData, *, dataset: Dataset | Path | None = None, output: Path | None = None) -> Path:
    """Write the report of a result to an HTML file and return the file's path.

    Parameters
    ----------
    result : Path or ReportData
        Result folder, or its data.
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
    report = result if isinstance(result, ReportData) else ReportData.read(Path(result), dataset)
    path = report.folder / "report.html" if output is None else output
    name = words.heading(report.subject, report.name)[0]
    script = files("rhizotwin.report").joinpath("page.js").read_text(encoding="utf-8")
    text = html_page.document(f"Roots of {name}", _full_report(report), script=script)
    atomic.write_bytes(path, text.encode("utf-8", "backslashreplace"), follow=output is not None)
    return path


def write_many(result_folders: Sequence[Path], output: Path) -> Path:
    """Write a single report of many results, beginning with a table of their volumes, and return its path.

    It shows pictures of the shapes, and leads to the reports in the folders of the results.
    """
    reports = [ReportData.read(Path(folder)) for folder in result_folders]
    reliable = sum(bool(one.summary["volume_trusted"]) for one in reports)
    known = [name for name in subject.NAMES if any(name in one.subject.known for one in reports)]
    names = result_names.names_of([one.folder for one in reports])
    rows = [_row(place, name, one, known) for place, (name, one) in enumerate(zip(names, reports, strict=True))]
    heading = f"{reliable} of {len(reports)} volumes reliable"
    head = ["verdict", "volume (90 % interval)", "result", *("scene", *known, "root length (mm)", "edits")]
    if not any(row[-1] for row in rows):
        head, rows = head[:-1], [row[:-1] for row in rows]
    overview = f"<h1>{heading}</h1>{table(rows, head=head, numbers=(1,), kind='overview')}"
    with ThreadPoolExecutor(min(threads(), MOST_AT_ONCE)) as pool:
        parts = list(pool.map(lambda one: _short_report(one, output.parent), reports))
    shown = [f'<section id="result-{place}" class=short>{part}</section>' for place, part in enumerate(parts)]
    atomic.write_text(output, html_page.document(heading, overview, *shown))
    return output


def _row(place: int, name: str, report: ReportData, known: Sequence[str]) -> list[str]:
    """Return the row of a result in the table of volumes."""
    length, interval = report.traits.total_length_mm, report.assessed["total_length_mm"]
    shown = "-" if not length else round_digits(length) + ("" if interval.verdict == "reliable" else f" ({interval.verdict})")
    link = Markup(f'<a href="#result-{place}">{escape(name)}</a>')
    described = (subject.as_text(report.subject)[key] for key in known)
    return [*tables.verdict(report.summary), link, report.name, *described, shown, result_traits.describe_edits(report.summary)]


def _full_report(report: ReportData) -> str:
    """Return the report of one result as an HTML section."""
    method = words.methods_paragraph(report.summary, roots=bool(report.roots), simulated=words.is_simulated(report.dataset))
    sections = {
        "Traits": _traits(report),
        "Plants": _plants(report),
        "Causes of uncertainty": tables.causes(report.summary),
        "Front and side": _front_and_side(report),
        "Root length": _lengths(report),
        "Figures": _figures(report.folder),
        "Methods": f"<p>{escape(method)}</p>",
        "Details": tables.details(report.summary, rig=_rig(report)),
    }
    rest = "".join(f'<section class="{name.split()[0].lower()}"><h2>{name}</h2>{text}</section>' for name, text in sections.items() if text)
    return f"<main data-result>{_head(report)}{_shape(report)}{rest}</main>"


def _short_report(report: ReportData, page_folder: Path) -> str:
    """Return the short report of one of many results as HTML, for a page in a folder."""
    picture, own = report.small_picture(), report.folder / "report.html"
    shape = "" if picture is None else html_page.image("webp", sides.webp(picture), "Shape from the front and from the side")
    link = quote(os.fsencode(Path(os.path.relpath(own, page_folder)).as_posix()))
    more = f'<p><a href="{link}">Report with the shape in 3D</a></p>' if own.is_file() else ""
    return f"<div>{_head(report, level=2)}{more}</div><figure>{shape}</figure><details><summary>Traits</summary>{_traits(report)}</details>"


def _head(report: ReportData, *, level: int = 1) -> str:
    """Return the heading of a report as HTML: name, subject, and the verdict with recommendations."""
    scan = "Simulated scan" if words.is_simulated(report.dataset) else "Scan"
    described = "" if report.dataset is None else ": ".join(filter(None, [scan, report.dataset.scene.description]))
    name, whose = words.heading(report.subject, report.name)
    plants = "; ".join(filter(None, [whose, report.solution and f"nutrient solution {report.solution}"]))
    edits = result_traits.describe_edits(report.summary)
    below = [plants, described, edits and f"Edited by hand: {edits}."]
    volume, beside = words.verdict(report.summary)
    state, meaning, advice = words.traffic_light(report.summary)
    more = f"<details{' open' * (state == 'bad')}><summary>{escape(meaning)}</summary>{items(advice)}</details>" if advice else ""
    heading = f"<h{level}>{escape(name)}</h{level}>" + "".join(f"<p class=soft>{escape(text)}</p>" for text in below if text)
    text = f"<p class=volume>{volume}</p><p>{beside}</p>{more}"
    return f'{heading}<div class="light {state}"><b role="img" aria-label="{state}"></b><div>{text}</div></div>'


def _shape(report: ReportData) -> str:
    """Return the canvas that shows the shape in 3D, and the buttons that save files, as HTML."""
    packed = shape_data.pack_shape(report.surface, report.roots)
    data = {
        "file": re.sub(r"[^A-Za-z0-9_-]+", "_", report.name) or "result",
        "csv": trait_table.to_csv(report.traits, report.assessed),
        "shape": packed,
    }
    if report.roots:
        data["rsml"] = base64.b64encode(gzip.compress((report.folder / "roots.rsml").read_bytes(), mtime=0)).decode()
    options = "".join(f"<option value={by}>{by}</option>" for by in packed["keys"]) + "<option value=plain>one colour</option>"
    mean_mm = report.traits.mean_diameter_mm
    checked = " checked" if mean_mm is not None and mean_mm < THIN_MM else ""  # because the surface of thin roots has gaps
    overlay = f"<label><input type=checkbox{checked}> centre lines</label>" if report.roots else ""
    saved = "".join(
        f'<button type=button data-file={kind} aria-label="save {what} ({kind.upper()})" title="{what}">{kind.upper()}</button>'
        for kind, what in SAVED.items()
        if kind != "rsml" or report.roots
    )
    return (
        f"<div class=solid><div class=controls><label>colour <select>{options}</select></label>{overlay}"
        f"<button type=button>reset view</button><span class=saved>save {saved}</span></div>"
        '<div class=stage><canvas aria-label="3D view of the shape"></canvas><div class=key></div>'
        "<div class=below><p>Drag to rotate, scroll or pinch to zoom, Shift and drag to pan.</p><div class=bar></div></div></div></div>"
        f"{html_page.json_element(data)}"
    )


def _front_and_side(report: ReportData) -> str:
    """Return renderings of the shape and pictures with its outline, from the front and from the side, as HTML."""
    drawn = figure(charts.sides(report.renderings), "Reconstructed surface, at the same scale.") if report.renderings else ""
    if report.dataset is None:
        return drawn + "<p class=soft>The dataset was not found when this report was written.</p>"
    return drawn + _pictures(report, report.dataset)


def _pictures(report: ReportData, dataset: Dataset) -> str:
    """Return pictures with the outline of the reconstruction, as HTML."""
    pictures = Pictures.of(dataset, report.summary)
    if not pictures.files:
        return ""
    lines = as_lines(report.roots)
    around = np.concatenate([report.surface.vertices_mm[::64], *(root.points_mm for root in report.roots)])
    places = {pictures.nearest(angle): name for name, angle in reversed(AZIMUTHS_DEG.items())}
    drawn: list[tuple[str, NDArray[np.uint8], NDArray[np.float64]]] = []
    for place, name in reversed(places.items()):
        with suppress(UserError):  # a picture that cannot be read is omitted from the report
            image = pictures.draw_outline(place, report.surface, lines)
            scale = image.shape[1] / pictures.views[place].camera.image_wh[0]
            drawn.append((name, image, scale * (pictures.pixels(place, around) + 0.5) - 0.5))
    share = max((_share(image, pixels) for _, image, pixels in drawn), default=1.0)
    shown = []
    for name, image, pixels in drawn:
        caption = f"Picture from the {name}, with the outline of the reconstruction."
        shown.append(figure(html_page.image("jpeg", _jpeg(_crop(image, pixels, share)), caption), caption))
    return f"<div class=pictures>{''.join(shown)}</div>"


def _share(image: NDArray[np.uint8], pixels: NDArray[np.float64]) -> float:
    """Return the fraction of a picture that contains projected points (N, 2), pixels, with a margin."""
    inside = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(inside):
        return 1.0
    high, wide = image.shape[:2]
    extent = np.ptp(inside, axis=0) * MARGIN / np.array([wide, high])
    return min(1.0, max(float(extent.max()), SMALLEST_PART))


def _crop(image: NDArray[np.uint8], pixels: NDArray[np.float64], share: float) -> NDArray[np.uint8]:
    """Crop a picture to a fraction of its width and height, around projected points (N, 2), in pixels.

    Small crops are enlarged.
    """
    inside = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(inside):
        return image
    high, wide = image.shape[:2]
    middle = (inside.min(axis=0) + inside.max(axis=0)) / 2.0
    size = share * np.array([wide, high])
    corner = np.clip(middle - size / 2.0, 0.0, np.array([wide, high]) - size).astype(int)
    cut = image[corner[1] : corner[1] + int(size[1]), corner[0] : corner[0] + int(size[0])]
    scale = max(1.0, LEAST_WIDE_PX / cut.shape[1])
    return np.asarray(cv2.resize(cut, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8)


def _jpeg(image: Any) -> bytes:
    if image.shape[1] > WIDEST_PX:
        scale = WIDEST_PX / image.shape[1]
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1])


def _plants(report: ReportData) -> str:
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
    pairs = "".join(f"<p>{'<br>'.join(escape(line.strip()) for line in one.lines(verdict))}</p>" for one in find_neighbours(report.roots))
    return table(rows, head=head, numbers=(1, 2, 3, 4, 5)) + pairs


def _traits(report: ReportData) -> str:
    """Return a table of the scalar traits with 90 % intervals or verdicts, and a table of all others, as HTML."""
    assessed, others, judged = [], [], dict[str, Assessment]()
    for definition in trait_table.DEFINITIONS:
        value, found = getattr(report.traits, definition.field), report.assessed[definition.field]
        if value is None:
            continue
        label, shown, interval, meaning = words.trait_text(definition, value, found)
        judged[label] = found
        if found.interval is None:
            others.append([label, shown, meaning])
        else:
            assessed.append([label, shown, interval, meaning])
    text = (
        ""
        if report.traits.total_length_mm is not None
        else "<p>No centre lines were found, so that lengths, diameters and angles are not available.</p>"
    )
    if assessed:
        text += table(assessed, head=("trait", "value", "90 % interval", "definition"), numbers=(1,), kind="traits")
    if refused := reasons({name: one for name, one in judged.items() if one.interval is not None}):
        text += items(refused)
    if others:
        why = reasons({name: one for name, one in judged.items() if one.interval is None})
        more = items(why) + table(others, head=("trait", "value", "definition"), numbers=(1,), kind="traits")
        text += f"<details><summary>Traits without an interval</summary>{more}</details>" if assessed else more
    return text


def _lengths(report: ReportData) -> str:
    """Return bar charts of root length by depth, diameter and order as HTML. It is empty if no lengths are known."""
    traits, up = report.traits, "length (mm)"
    if not traits.length_by_depth_mm:
        return ""
    orders = traits.length_by_order_mm
    shades = [f"rgb{root_colours.ORDERS[min(order, len(root_colours.ORDERS) - 1)]}" for order in range(len(orders))]
    drawn = (
        charts.bars(traits.length_by_depth_mm, DEPTH_BIN_MM, name="length by depth", across="depth below the top (mm)", up=up),
        charts.bars(traits.length_by_diameter_mm, DIAMETER_BIN_MM, name="length by diameter", across="diameter (mm)", up=up),
        charts.bars(orders, 0.0, name="length by order", across="order (0: main root)", up=up, colours=shades),
    )
    return f"<div class=charts>{''.join(drawn)}</div>"


def _figures(folder: Path) -> str:
    """Return the figures in the result's folder as HTML."""
    there = {folder / "pictures" / name: caption for name, caption in CAPTIONS.items() if (folder / "pictures" / name).is_file()}
    return "".join(figure(html_page.image("png", path.read_bytes(), caption), caption) for path, caption in there.items())


def _rig(report: ReportData) -> str:
    if report.dataset is None:
        return ""
    cameras = figure(rig_figure.cameras(report.summary, report.dataset.scene), "Cameras from above, as estimated. Red: not used.")
    planned = figure(rig_figure.svg(report.dataset.scene), "Rig from the side, as planned.")
    return f"<div class=wide><div class=rig>{planned}{cameras}</div></div>"
