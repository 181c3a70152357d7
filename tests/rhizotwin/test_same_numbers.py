"""The numbers of one result are the same in report, viewer, terminal, CSV and API."""

import csv
import html
import io
import re
from pathlib import Path

import pytest

import rhizotwin as rt
from rhizotwin.corrections import corrected, log
from rhizotwin.recon.results import assessments
from rhizotwin.report import page, words
from rhizotwin.scenes.trait_table import DEFINITIONS
from rhizotwin.viewer import words as panel
from rhizotwin.viewer.shown import Shown
from tests.command import Command
from tests.rhizotwin import plant as plants


def digits(text: str) -> float:
    """Return half a unit of the last digit of a number."""
    return 0.5 * 10.0 ** -len(text.partition(".")[2]) if "." in text else 0.5


def test_report_viewer_terminal_csv_and_api_agree(plant: plants.Plant, tmp_path: Path, command: Command) -> None:
    result, shown = rt.load_result(plant.result), Shown(plant.result, plant.dataset)
    summary = result.summary()
    report = page.write(plant.result).read_text(encoding="utf-8")
    viewer = panel.traits(shown.traits(), edited=False, summary=summary)
    terminal = command.works("traits", plant.result).out.splitlines()
    (written,) = rt.export(plant.result, tmp_path / "traits.csv")
    tables = [list(csv.DictReader(io.StringIO(path.read_text()))) for path in (written, plant.result / "traits.csv")]
    assessed = assessments.assess(summary, result.measured)
    known = [(k, d) for k, d in enumerate(DEFINITIONS) if getattr(result.measured, d.field) is not None]
    assert len(known) > 15
    for k, definition in known:
        value = getattr(result.measured, definition.field)
        assert getattr(shown.traits(), definition.field) == pytest.approx(value, rel=1e-6)
        name, text, interval, _ = words.trait_text(definition, value, assessed[definition.field])
        row = f"<td>{html.escape(name)}</td><td class=number>{html.escape(text)}</td><td>"
        assert (row if interval == "no interval" else f"{row}{html.escape(interval)}</td>") in report
        assert f"{html.escape(name)}</td><td>{html.escape(text)}<br><small>{html.escape(interval)}</small>" in viewer
        for table in tables:
            assert float(table[k]["value"]) == pytest.approx(value, rel=1e-6)
        (line,) = (line for line in terminal if line.split()[:1] == [definition.name])
        number = line.split()[1]
        assert float(number) == pytest.approx(value, abs=1.001 * digits(number))
        in_unit = re.match(r"[\d.]+", text)
        assert in_unit is not None
        scale = 1000.0 if definition.unit == "mm3" else 1.0
        assert float(in_unit[0]) == pytest.approx(value / scale, abs=1.001 * digits(in_unit[0]))
    headline = words.headline(summary)[0].removeprefix("volume ")
    assert f"<p class=volume>{headline}</p>" in report
    assert f"</b>{headline}</h1>" in panel.volume(summary, shown.session.measure(), edits=0)
    assert headline in repr(result)
    assert headline in result._repr_html_()


def test_viewer_and_corrected_result_have_the_same_traits(plant: plants.Plant, tmp_path: Path) -> None:
    shown = Shown(plant.result, plant.dataset)
    shown.session.do(log.edit("delete roots", roots=[2]))
    corrected.write(shown.session, tmp_path / "corrected", dataset=plant.dataset)
    measured = rt.load_result(tmp_path / "corrected").measured
    ours, theirs = ([getattr(traits, one.field) for one in DEFINITIONS] for traits in (shown.traits(), measured))
    assert ours == [None if value is None else pytest.approx(value, rel=1e-6) for value in theirs]
