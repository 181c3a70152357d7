"""Table and page of a batch."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urljoin, urlsplit

import pytest

from rhizotwin.batches import jobs, overview
from rhizotwin.batches.jobs import Outcome
from tests.command import Command
from tests.rhizotwin.batches.conftest import job


def test_the_table_and_the_page_name_plants_and_failures(ball_result: Callable[..., Path], tmp_path: Path) -> None:
    ball_result("one", subject={"plant": "P<1>", "treatment": "low N"})
    (tmp_path / "two").mkdir()
    overview.write(tmp_path, [job("one", tmp_path)], [(job("two", tmp_path), "the picture <x> is missing")])
    page = (tmp_path / overview.PAGE).read_text(encoding="utf-8")
    assert "P&lt;1&gt;" in page
    assert "<b>two</b>: the picture &lt;x&gt; is missing" in page
    assert "low N" in (tmp_path / overview.TABLE).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["plant #3", "50 %25", "day:1?", os.fsdecode(b"\xff")])
def test_the_page_leads_to_reports_of_all_names(name: str, ball_result: Callable[..., Path], tmp_path: Path) -> None:
    ball_result(name)
    overview.write(tmp_path, [job(name, tmp_path)], [])
    (link,) = re.findall('href="([^"]*/report.html)"', (tmp_path / overview.PAGE).read_text(encoding="utf-8"))
    found = urlsplit(urljoin((tmp_path / overview.PAGE).as_uri(), link))
    assert (found.scheme, os.fsdecode(unquote_to_bytes(found.path))) == ("file", str(tmp_path / name / "report.html"))


def test_volumes_that_are_not_usable_are_counted_by_reason() -> None:
    term = {"name": "radii", "less_mm3": 50.0, "more_mm3": 20.0}
    narrow = {"volume_mm3": 100.0, "volume_interval_mm3": [95.0, 105.0], "volume_budget": [term], "views": [{"used": True}] * 12}
    wide = narrow | {"volume_interval_mm3": [50.0, 120.0], "volume_trusted": False}
    dirty = narrow | {"volume_trusted": False, "checks": [{"name": "dirt", "state": "bad"}]}
    good = narrow | {"volume_trusted": True, "checks": [{"name": "dirt", "state": "fair"}]}
    reasons = "2 x dirty canister, 1 x wide interval, 1 x high radii"
    assert overview.summarise([wide, dirty, dirty]) == f"0 of 3 volumes usable; not usable: {reasons}"
    assert overview.summarise([good, good]) == "2 of 2 volumes usable"
    assert overview.summarise([dirty | {"checks": []}]) == "0 of 1 volumes usable; not usable: 1 x other"


@pytest.mark.slow
def test_the_overview_fits_a_narrow_screen(browser: Any, ball_result: Callable[..., Path], tmp_path: Path) -> None:
    ball_result("one", subject={"plant": "P1", "treatment": "low N"})
    overview.write(tmp_path, [job("one", tmp_path)], [])
    shown = browser.new_page(viewport={"width": 400, "height": 700})
    shown.goto((tmp_path / overview.PAGE).as_uri())
    widths = "[document.documentElement.scrollWidth, document.querySelector('.wide').scrollWidth]"
    assert max(shown.evaluate(widths)) <= 400
    visible = [cell.inner_text() for cell in shown.locator("th").all() if cell.is_visible()]
    assert visible == ["verdict", "volume (90 % interval)", "", "scan"]
    shown.close()


def test_a_batch_folder_stands_for_its_results(tmp_path: Path, ball_result: Callable[..., Path], command: Command) -> None:
    ball_result("r/one")
    ball_result(os.fsdecode(b"r/\xff\x1b"))
    jobs.note(job("one", tmp_path / "r"), Outcome(name="one", state="done"))
    overview.write(tmp_path / "r", [job(os.fsdecode(b"\xff\x1b"), tmp_path / "r")], [])
    printed = command.works("traits", tmp_path / "r")
    command.works("traits", tmp_path / "r", "-o", tmp_path / "t.csv")
    assert len((tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()) == 3
    written = command.works("report", tmp_path / "r", "-o", tmp_path / "p.html")
    assert "\x1b" not in printed.out + printed.err + written.out + written.err
