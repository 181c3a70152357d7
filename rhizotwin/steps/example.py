"""Finished example: simulated scan of a print with its reconstruction and a correction (``packaging/example.py``)."""

from __future__ import annotations

import json
import shutil
from importlib.resources import files
from pathlib import Path

from rhizotwin.scenes.atomic import write_json
from rhizotwin.scenes.folders import new_folder

ARCHIVE = "example.tar.xz"
"""Archive with the folders ``dataset`` and ``result``."""


def write_example(folder: Path) -> None:
    """Write the example to a new or empty folder, with the report of the result.

    Raises
    ------
    UserError
        If the folder is not empty or cannot be written.
    """
    from rhizotwin.report import page
    from rhizotwin.report.report_data import ReportData
    from rhizotwin.report.result_pictures import write_pictures

    with new_folder(folder) as building:
        shutil.unpack_archive(str(files(__package__).joinpath(ARCHIVE)), building, filter="data")
        result = building / "result"
        report = ReportData.read(result, building / "dataset")
        write_pictures(report)
        page.write(report)
        summary = json.loads((result / "result.json").read_text(encoding="utf-8"))
        write_json(result / "result.json", summary | {"dataset": str(folder.resolve() / "dataset")})
