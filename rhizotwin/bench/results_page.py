"""HTML page with a sortable table of benchmark results."""

from __future__ import annotations

import html
from collections.abc import Sequence

from rhizotwin.bench.results import QUANTITIES, Results, held, ordered, remark, text, value

_STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 1.5rem; color: #222; background: #fff; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #ddd; text-align: right; white-space: nowrap; }
th:nth-child(-n+3), td:nth-child(-n+3), td:last-child { text-align: left; }
td:last-child { white-space: normal; min-width: 12rem; }
th button { all: unset; cursor: pointer; font-weight: 600; }
th button:focus-visible { outline: 2px solid #2166ac; }
th[aria-sort=ascending] button::after { content: " \\25B2"; }
th[aria-sort=descending] button::after { content: " \\25BC"; }
tr.wrong td { color: #b2182b; }
@media (prefers-color-scheme: dark) {
  body { background: #1b1b1b; color: #ddd; } th, td { border-color: #444; } tr.wrong td { color: #ef8a62; }
}
"""
_SCRIPT = """
for (const button of document.querySelectorAll("th button")) button.addEventListener("click", () => {
  const head = button.closest("th"), table = head.closest("table"), column = head.cellIndex, body = table.tBodies[0];
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const key = row => row.cells[column].dataset.value ?? row.cells[column].textContent;
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
    rows = []
    for one, row in ordered(several):
        cells = [_cell(one.benchmark), _cell(row["case"]), _cell(one.label), _cell(held(row))]
        for quantity in shown:
            found = value(row, quantity)
            size = None if found is None else abs(found) if quantity.name.endswith("_error") else found
            cells.append(_cell(text(row, quantity), size))
        rows.append(f"<tr{' class=wrong' if row['state'] != 'done' else ''}>{''.join(cells)}{_cell(remark(row))}</tr>")
    head = "".join(f'<th scope="col"><button type="button">{html.escape(name)}</button></th>' for name in heads)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>Benchmark results</title><style>{_STYLE}</style></head><body><h1>Benchmark results</h1>"
        "<p>Errors are estimated value / true value - 1, and are sorted by absolute value. The interval is the 90 % interval of the volume "
        "that the method reports. The interval score is the width of the interval plus a penalty if the interval misses the true "
        "volume, relative to the true volume; smaller scores are better.</p>"
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
        f"<script>{_SCRIPT}</script></body></html>\n"
    )


def _cell(shown: str, size: float | None = None) -> str:
    data = "" if size is None else f' data-value="{size:.9g}"'
    return f"<td{data}>{html.escape(shown)}</td>"
