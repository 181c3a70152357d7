"""What a batch ends with: one table of traits, and one page with a row and a picture for each scan."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import cv2

from rhizotwin.batch.jobs import Job
from rhizotwin.recon.results import assessments, result_traits
from rhizotwin.recon.results.parts import Json
from rhizotwin.report import words
from rhizotwin.scenes import atomic, subject, trait_table
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files, stored_traits

TABLE, PAGE = "traits.csv", "overview.html"
THUMBNAIL_PX = 180
MOST_NAMED = 5
"""Scans that are named in a sentence; the page has all."""
_COLUMNS = ("total_length_mm", "depth_mm", "mean_diameter_mm", "tips")


@dataclass(frozen=True, kw_only=True)
class _Row:
    """A finished scan."""

    name: str
    summary: Json
    traits: Traits
    picture: bytes | None

    @cached_property
    def assessed(self) -> dict[str, Assessment]:
        return assessments.assess(self.summary, self.traits)


def write(folder: Path, done: Sequence[Job], failed: Sequence[tuple[Job, str]]) -> tuple[list[Path], str]:
    """Write the table and the page of a batch into the folder of its results.

    Parameters
    ----------
    done : sequence of Job
        Whose results lie in the folder, by their names.
    failed : sequence of tuple of Job, str
        With the sentence that says why.

    Returns
    -------
    list of Path
        The table and the page.
    str
        A sentence on the volumes that are not reliable; empty where there is none.
    """
    rows = []
    broken = list(failed)
    for job in sorted(done, key=lambda job: job.name):
        try:
            result = folder / job.name
            summary = result_files.read_summary(result)
            rows.append(_Row(name=job.name, summary=summary, traits=stored_traits.read(result), picture=_thumbnail(result)))
        except UserError as error:
            broken.append((job, str(error)))
    refused = [f"{row.name}: {row.assessed['volume_mm3'].reason}" for row in rows if row.assessed["volume_mm3"].verdict == "not reliable"]
    more = f"; and {len(refused) - MOST_NAMED} more" if len(refused) > MOST_NAMED else ""
    sentence = f"{len(refused)} of {len(rows)} volumes are not reliable: {'; '.join(refused[:MOST_NAMED])}{more}" if refused else ""
    table = stored_traits.spreadsheet([(row.name, row.summary, row.traits) for row in rows])
    for name, text in ((TABLE, table), (PAGE, _page(rows, broken, sentence))):
        atomic.write_bytes(folder / name, text.encode("utf-8", "backslashreplace"), follow=False)
    return [folder / TABLE, folder / PAGE], sentence


def _thumbnail(result: Path) -> bytes | None:
    image = result_files.read_shape_picture(result)
    if image is None:
        return None
    scale = THUMBNAIL_PX / image.shape[0]
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())


def _page(rows: Sequence[_Row], failed: Sequence[tuple[Job, str]], sentence: str) -> str:
    told = [name for name in subject.NAMES if any(_subject(row)[name] for row in rows)]
    shown = [definition for definition in trait_table.DEFINITIONS if definition.field in _COLUMNS]
    head = ["", "scan", *told, "volume", "90 % interval", "", *(d.heading for d in shown)]
    style = files("rhizotwin.report").joinpath("page.css").read_text(encoding="utf-8")
    listed = "".join(f"<li><b>{html.escape(job.name)}</b>: {html.escape(sentence)}</li>" for job, sentence in failed)
    title = f"{len(rows)} scans" + (f", {len(failed)} failed" if failed else "")
    table = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><link rel="icon" href="data:,">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">"
        f"<title>{title}</title><style>{style}</style></head><body><h1>{title}</h1>{f'<ul>{listed}</ul>' if listed else ''}"
        f"<p>{html.escape(sentence)}</p>"
        f"<div class=wide><table><tr>{table}</tr>{''.join(_row(row, told, shown) for row in rows)}</table></div></body></html>\n"
    )


def _row(row: _Row, told: Sequence[str], shown: Sequence[trait_table.Definition]) -> str:
    found, interval = words.volume(row.summary)
    state = "not reliable" if words.light(row.summary)[0] == "bad" else "can be used"
    source = "" if row.picture is None else f'<img alt="shape" src="data:image/jpeg;base64,{base64.b64encode(row.picture).decode()}">'
    name = html.escape(row.name, quote=True)
    cells = [source, f'<a href="{name}/report.html">{name}</a>', *(html.escape(_subject(row)[key]) for key in told)]
    numbers = [_number(row, d.field) for d in shown]
    text = "".join(f"<td>{cell}</td>" for cell in cells)
    return (
        f"<tr>{text}<td class=number>{found}</td><td class=number>{interval}</td><td>{state}</td>"
        f"{''.join(f'<td class=number>{number}</td>' for number in numbers)}</tr>"
    )


def _number(row: _Row, field: str) -> str:
    """Return a trait with its verdict, where that is not good."""
    value, verdict = getattr(row.traits, field), row.assessed[field].verdict
    return trait_table.format_number(value) if value is None or verdict == "reliable" else f"{trait_table.format_number(value)} ({verdict})"


def _subject(row: _Row) -> dict[str, str]:
    """Return the subject of a row; of several plants the names together."""
    each = [subject.as_text(own.subject) for own in result_traits.traits_by_plant(row.name, row.summary, row.traits)]
    return {key: ", ".join(dict.fromkeys(text for one in each if (text := one[key]))) for key in each[0]}
