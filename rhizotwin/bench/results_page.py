"""HTML page with a sortable table of benchmark results."""

from __future__ import annotations

from collections.abc import Sequence

from rhizotwin.bench.results import QUANTITIES, Results, held, ordered, remark, text, value
from rhizotwin.scenes import html_page
from rhizotwin.scenes.html_page import Markup, escape, table

_SCRIPT = """
for (const button of document.querySelectorAll("th button")) button.addEventListener("click", () => {
  const head = button.closest("th"), table = head.closest("table"), column = head.cellIndex, body = table.tBodies[0];
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const key = row => row.cells[column].querySelector("[data-value]")?.dataset.value ?? row.cells[column].textContent;
  const order = (a, b) => { const x = key(a), y = key(b);
    if (x === "" || y === "") return (x === "") - (y === "");
    const d = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y; return down ? -d : d; };
  body.append(...[...body.rows].sort(order));
});
"""


def page(several: Sequence[Results]) -> str:
    """Return a self-contained HTML page with a sortable table of results.

    Parameters
    ----------
    several : sequence of Results
        Results of one or more methods on one or more benchmarks.
    """
    shown = [quantity for quantity in QUANTITIES if any(text(row, quantity) for one in several for row in one.rows.values())]
    heads = ["benchmark", "case", "method", "interval", *(quantity.heading for quantity in shown), "remarks"]
    rows: list[list[str]] = []
    marked = []
    for one, row in ordered(several):
        cells = [one.benchmark, row["case"], one.label, held(row)]
        for quantity in shown:
            found = value(row, quantity)
            size = None if found is None else abs(found) if quantity.name.endswith("_error") else found
            cells.append(_sorted_by(text(row, quantity), size))
        if row["state"] != "done":
            marked.append(len(rows))
        rows.append([*cells, remark(row)])
    head = [Markup(f'<button type="button">{escape(name)}</button>') for name in heads]
    return html_page.document(
        "Benchmark results",
        "<h1>Benchmark results</h1>"
        "<p>Errors are estimated value / true value - 1, and are sorted by absolute value. The interval is the 90 % interval of the volume "
        "that the method reports. The interval score is the width of the interval plus a penalty if the interval misses the true "
        "volume, relative to the true volume; smaller scores are better.</p>",
        table(rows, head=head, numbers=range(3, len(head) - 1), marked=marked, kind="sortable"),
        script=_SCRIPT,
    )


def _sorted_by(shown: str, size: float | None) -> str:
    """Return the text of a cell with the number by which its column is sorted."""
    return shown if size is None else Markup(f'<span data-value="{size:.9g}">{escape(shown)}</span>')
