"""Overview of a batch: trait table, and HTML page with verdict, volume and picture of each scan."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from urllib.parse import quote

import cv2

from rhizotwin.batches.jobs import Job
from rhizotwin.recon.results import assessments, reasons, result_traits
from rhizotwin.recon.results.parts import Json
from rhizotwin.report import tables, words
from rhizotwin.scenes import atomic, html_page, subject, trait_table
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.html_page import Markup, escape, items, table
from rhizotwin.scenes.traits import Traits
from rhizotwin.stored import result_files, stored_traits

TABLE, PAGE = "traits.csv", "overview.html"
THUMBNAIL_PX = 112
"""Height of the pictures in the overview, in pixels. The page shows them at half this height."""
_COLUMNS = ("total_length_mm", "depth_mm", "mean_diameter_mm", "tips")


@dataclass(frozen=True, kw_only=True)
class _Row:
    """Finished scan with its summary, traits and picture."""

    name: str
    summary: Json
    traits: Traits
    picture: bytes | None

    @cached_property
    def assessed(self) -> dict[str, Assessment]:
        return assessments.assess(self.summary, self.traits)


def write(folder: Path, done: Sequence[Job], failed: Sequence[tuple[Job, str]]) -> tuple[list[Path], str]:
    """Write the trait table and the HTML page of a batch to the folder of the results.

    Parameters
    ----------
    folder : Path
        Folder of the results.
    done : sequence of Job
        Finished jobs, whose names are those of the result folders.
    failed : sequence of tuple of Job, str
        Failed jobs with their messages.

    Returns
    -------
    list of Path
        Paths of the table and the page.
    str
        Summary such as "3 of 12 volumes reliable; not reliable: 7 x inconsistent views, 2 x blurred pictures".
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
    sentence = summarise([row.summary for row in rows])
    sheet = stored_traits.spreadsheet([(row.name, row.summary, row.traits) for row in rows])
    for name, text in ((TABLE, sheet), (PAGE, _page(rows, broken, sentence))):
        atomic.write_bytes(folder / name, text.encode("utf-8", "backslashreplace"), follow=False)
    return [folder / TABLE, folder / PAGE], sentence


def summarise(summaries: Sequence[Json]) -> str:
    """Return a text with the number of reliable volumes, and with the number of scans for each reason of the others."""
    codes = Counter(code for summary in summaries for code in reasons.reasons_for_volume(summary))
    reliable = sum(bool(summary["volume_trusted"]) for summary in summaries)
    counted = ", ".join(f"{count} x {code.replace('_', ' ')}" for code, count in codes.most_common())
    return f"{reliable} of {len(summaries)} volumes reliable" + (f"; not reliable: {counted}" if counted else "")


def _thumbnail(result: Path) -> bytes | None:
    """Return the front view of the reconstructed shape as a small JPEG picture.

    The result is None if the reconstruction has stored no picture of the shape.
    """
    image = result_files.read_shape_picture(result)
    if image is None:
        return None
    half = image[:, : image.shape[1] // 2]
    scale = THUMBNAIL_PX / half.shape[0]
    small = cv2.resize(half, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())


def _page(rows: Sequence[_Row], failed: Sequence[tuple[Job, str]], summary: str) -> str:
    known = [name for name in subject.NAMES if any(_subject(row)[name] for row in rows)]
    shown = [definition for definition in trait_table.DEFINITIONS if definition.field in _COLUMNS]
    head = ["verdict", "volume (90 % interval)", "", "scan", *known, *(words.title(definition.heading) for definition in shown)]
    numbers = [1, *range(4 + len(known), len(head))]
    listed = [Markup(f"<b>{escape(job.name)}</b>: {escape(sentence)}") for job, sentence in failed]
    overview = table([_cells(row, known, shown) for row in rows], head=head, numbers=numbers, kind="overview")
    title = f"{len(rows)} scans" + (f", {len(failed)} failed" if failed else "")
    return html_page.document(title, f"<h1>{title}</h1>{items(listed)}<p>{escape(summary)}</p>", overview)


def _cells(row: _Row, known: Sequence[str], shown: Sequence[trait_table.Definition]) -> list[str]:
    image = "" if row.picture is None else Markup(html_page.image("jpeg", row.picture, "shape"))
    link = Markup(f'<a href="{quote(os.fsencode(row.name))}/report.html">{escape(row.name)}</a>')
    described = _subject(row)
    return [*tables.verdict(row.summary), image, link, *(described[key] for key in known), *(_number(row, d.field) for d in shown)]


def _number(row: _Row, field: str) -> str:
    """Format the value of a trait for the table, with a note in parentheses if it is not reliable."""
    value = getattr(row.traits, field)
    verdict = row.assessed[field].verdict
    text = trait_table.format_number(value)
    return text if value is None or verdict != "not reliable" else f"{text} ({verdict})"


def _subject(row: _Row) -> dict[str, str]:
    """Return the description of the plants in a scan, keyed by field, such as species or treatment.

    If the scan has several plants, their values are joined by commas.
    """
    each = [subject.as_text(own.subject) for own in result_traits.traits_by_plant(row.name, row.summary, row.traits)]
    return {key: ", ".join(dict.fromkeys(text for one in each if (text := one[key]))) for key in each[0]}
