"""Copy datasets and results to a folder with licence, authors, metadata, checksums and an overview."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.publishing import crate, miappe, published
from rhizotwin.publishing.published import Found, Scan
from rhizotwin.publishing.study import LICENCES, Study
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import file_sha256, read_image
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.provenance import versions
from rhizotwin.stored import result_files, stored_traits

CHECKSUMS = "checksums-sha256.txt"
"""Name of the file with checksums."""
Image = NDArray[np.uint8 | np.uint16]
_ACROSS, _EDGE_PX = 4, 320
"""Number of pictures in each row of the contact sheet, and maximum length of the longer edge of a picture in pixels."""


def publish(sources: Sequence[Path], output: Path, study: Study, *, monitor: Monitor) -> list[str]:
    """Write a folder that can be uploaded to a data repository.

    Parameters
    ----------
    sources : sequence of Path
        Datasets, results, or folders that contain them.
    output : Path
        Output folder, which must be new or empty.
    study : Study
        Description of the data.
    monitor : Monitor
        Progress monitor.

    Returns
    -------
    list of str
        Sentences about information that is missing.

    Raises
    ------
    UserError
        If a file is damaged or a link, the output folder is not empty, or rocrate is not installed.
    """
    study = replace(study, published=study.published or datetime.now(UTC).date().isoformat())
    scans, results = published.find(sources)
    version = versions(())["rhizotwin"]
    with new_folder(output) as building:
        published.copy(scans, results, building, monitor=monitor)
        files = {
            "README.md": "Description of the contents",
            "LICENSE.txt": "Licence of all files in this folder",
            "contact_sheet.png": "One picture of each scan and shape",
        }
        atomic.write_text(building / "README.md", _readme(study, scans, results))
        atomic.write_text(building / "LICENSE.txt", _licence(study))
        atomic.write_bytes(building / "contact_sheet.png", _contact_sheet(scans, results))
        if results:
            files["traits.csv"] = "Traits of all results with 90 % intervals and verdicts"
            rows = [(found.name, found.summary, found.traits) for found in results]
            atomic.write_text(building / "traits.csv", stored_traits.spreadsheet(rows))
        (building / "miappe").mkdir()
        for name, text in miappe.tables(study, scans, results).items():
            files[f"miappe/{name}"] = f"MIAPPE {miappe.VERSION}: {Path(name).stem.replace('_', ' ')}"
            atomic.write_text(building / "miappe" / name, text)
        files[CHECKSUMS] = "SHA-256 of every other file; check with: sha256sum -c"
        atomic.write_text(building / CHECKSUMS, "")  # the entry must exist before the file is written
        crate.write(building, study, scans, results, files=files, version=version)
        atomic.write_text(building / CHECKSUMS, _checksums(building))
    unknown = miappe.missing(study, scans, results)
    return [f"MIAPPE also requires {', '.join(unknown)}; enter what is known, and publish again"] if unknown else []


def _licence(study: Study) -> str:
    names = ", ".join(author.name for author in study.authors)
    return (
        f"{study.title}\n{study.published[:4]}, {names}\n\nThe files in this folder are published under the {LICENCES[study.licence]}.\n"
        f"Text of the licence: {study.licence_url}\n\nSPDX-License-Identifier: {study.licence}\n"
    )


def _checksums(folder: Path) -> str:
    """Return the SHA-256 checksums of all files in the format of sha256sum."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    names = {path.relative_to(folder).as_posix(): path for path in files}
    return "".join(f"{file_sha256(path)}  {name}\n" for name, path in names.items() if name != CHECKSUMS)


def _contact_sheet(scans: Sequence[Scan], results: Sequence[Found]) -> bytes:
    """Draw the contact sheet of a publication, and return it as PNG.

    It shows the middle picture of each scan, and the shape of each result.
    """
    shown = [(scan.name, _small(read_image(scan.dataset, scan.dataset.frames[len(scan.dataset.frames) // 2]))) for scan in scans]
    for found in results:
        shape = result_files.read_shape_picture(found.folder)
        if shape is not None:
            shown.append((f"{found.name}: shape", _small(cv2.cvtColor(shape, cv2.COLOR_BGR2GRAY))))
    across = max(1, min(_ACROSS, len(shown)))
    rows = max(1, -(-len(shown) // across))
    drawn = figure(3.0 * across, 2.6 * rows)
    for axes, (name, picture) in zip(drawn.subplots(rows, across, squeeze=False).ravel(), shown, strict=False):
        axes.imshow(picture, cmap="gray", vmin=0, vmax=np.iinfo(picture.dtype).max)
        axes.set_title(name, fontsize=8, parse_math=False)
    for axes in drawn.axes:
        axes.axis("off")
    return png(drawn, dpi=110)


def _small(picture: Image) -> Image:
    scale = min(1.0, _EDGE_PX / max(picture.shape[:2]))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _readme(study: Study, scans: Sequence[Scan], results: Sequence[Found]) -> str:
    """Return the text of README.md."""
    people = ", ".join(author.name + (f" ({author.affiliation})" if author.affiliation else "") for author in study.authors)
    names = ", ".join(author.name for author in study.authors)
    paper = f" Supplement to https://doi.org/{study.publication_doi}." if study.publication_doi else ""
    lines = [
        *(f"# {study.title}", "", study.description, ""),
        *(f"**Authors:** {people}", "", f"**Licence:** [{LICENCES[study.licence]}]({study.licence_url})", ""),
        *(f"**Cite as:** {names} ({study.published[:4]}): {study.title}. Data set.{paper}", ""),
        *("| file or folder | contents |", "|---|---|"),
        f"| `{published.SCANS}/` | scans ({len(scans)}): pictures, with scene and rig data (`dataset.json`) |",
        f"| `{published.RESULTS}/` | reconstructions ({len(results)}): surface (PLY), centre lines (RSML), traits, report |",
        *(["| `traits.csv` | traits of all results with 90 % intervals and verdicts |"] if results else []),
        "| `LICENSE.txt` | licence |",
        "| `contact_sheet.png` | one picture of each scan and shape |",
        f"| `miappe/` | tables of MIAPPE {miappe.VERSION} |",
        "| `ro-crate-metadata.json` | machine-readable metadata (RO-Crate) |",
        f"| `{CHECKSUMS}` | checksums; verify with `sha256sum -c {CHECKSUMS}` |",
        *("", "| scan | pictures | plant | source |", "|---|---|---|---|"),
    ]
    for scan in scans:
        whose = "; ".join(filter(None, (str(one) for one in miappe.subjects(scan)))).replace("|", "/")
        made = "simulation" if scan.simulated else "camera"
        lines.append(f"| `{scan.place}` | {len(scan.dataset.frames)} | {whose} | {made} |")
    lines += [
        "",
        "To open a result, install rhizotwin (`ro-crate-metadata.json` states its version), and run `rhizotwin view results/NAME`.",
        "",
    ]
    return "\n".join(lines)
