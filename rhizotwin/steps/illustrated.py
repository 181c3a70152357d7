"""Result of the Python interface, which is saved like that of the command line."""

from __future__ import annotations

from pathlib import Path

from rhizotwin.stored import save


class Result(save.Result):
    """Result of a reconstruction, as returned by `rhizotwin.reconstruct` and `rhizotwin.load_result`.

    The method `save` writes it to a folder, with the picture of its shape and its report.
    """

    def illustrate(self, folder: Path) -> None:
        """Add the picture of the shape and the report to the files of the result."""
        from rhizotwin.report import page
        from rhizotwin.report.report_data import ReportData
        from rhizotwin.report.result_pictures import write_pictures
        from rhizotwin.stored.result_files import find_dataset

        report = ReportData.of(self, folder, find_dataset(folder, self.summary(), None))
        write_pictures(report)
        page.write(report)
