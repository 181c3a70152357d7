"""HTML pages without outside references: document with style sheet and security policy, tables, lists and figures."""

import base64
import html
import json
from collections.abc import Collection, Sequence
from importlib.resources import files
from typing import Any

Cells = Sequence[str]


class Markup(str):
    """Text that is HTML already. Other text is escaped."""

    __slots__ = ()


def escape(text: str) -> str:
    """Return text as HTML."""
    return text if isinstance(text, Markup) else html.escape(text)


def palette() -> str:
    """Return the style sheet with the colours of all pages."""
    return files("rhizotwin.scenes").joinpath("palette.css").read_text(encoding="utf-8")


def document(title: str, *parts: str, script: str = "") -> str:
    """Return a complete HTML page that loads nothing.

    Its policy forbids all requests, and scripts other than ``script``.

    Parameters
    ----------
    title : str
        Title of the window.
    *parts : str
        Content of the page as HTML.
    script : str
        JavaScript that runs after the page is loaded.
    """
    style = palette() + files("rhizotwin.scenes").joinpath("page.css").read_text(encoding="utf-8")
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'" + ("; script-src 'unsafe-inline'" if script else "")
    code = f"<script>{script}</script>" if script else ""
    content = "".join(parts)
    body = content if "<main" in content else f"<main>{content}</main>"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><link rel="icon" href="data:,">'
        f"<title>{html.escape(title)}</title><style>{style}</style></head><body>{body}{code}</body></html>\n"
    )


def table(rows: Sequence[Cells], *, head: Cells = (), numbers: Collection[int] = (), marked: Collection[int] = (), kind: str = "") -> str:
    """Return rows of text as an HTML table that scrolls sideways where it is too wide.

    Parameters
    ----------
    rows : sequence of sequence of str
        Cells.
    head : sequence of str
        Headings of the columns.
    numbers : collection of int
        Indices of the right-aligned columns.
    marked : collection of int
        Indices of the rows that are drawn in the colour of warnings.
    kind : str
        Class of the table in the style sheet.
    """
    top = f"<thead><tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr{' class=out' if k in marked else ''}>{cells(row, numbers=numbers)}</tr>" for k, row in enumerate(rows))
    return f'<div class=wide tabindex=0><table class="{kind}">{top}<tbody>{body}</tbody></table></div>'


def cells(row: Cells, *, numbers: Collection[int] = ()) -> str:
    """Return the HTML cells of a row of `table`."""
    return "".join(f"<td{' class=number' if k in numbers else ''}>{escape(cell)}</td>" for k, cell in enumerate(row))


def items(texts: Sequence[str]) -> str:
    """Return texts as a list, or an empty text if there are none."""
    return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>" if texts else ""


def image(kind: str, data: bytes, name: str) -> str:
    """Return a picture as an HTML element.

    Parameters
    ----------
    kind : str
        Format of the picture, such as png.
    data : bytes
        Content of the picture's file.
    name : str
        Text for readers who cannot see the picture.
    """
    return f'<img alt="{escape(name)}" src="{data_uri(f"image/{kind}", data)}">'


def figure(content: str, caption: str) -> str:
    """Return a picture or drawing with its caption."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def data_uri(kind: str, data: bytes) -> str:
    """Return data of a media type as the address of an embedded file."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def json_element(data: Any) -> str:
    """Return data as JSON in an element that scripts can read, without characters that could end the element."""
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return f'<script type="application/json">{text}</script>'
