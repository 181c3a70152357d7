"""Tolerant parsing of the XML in RSML files.

Undeclared prefixes are accepted, and names are compared without regard to case. Document types are rejected.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from xml.parsers import expat

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.reading import read_file


def parse(path: Path) -> ET.Element:
    """Parse XML. Undeclared prefixes are accepted, and document types and entities are rejected."""
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.buffer_text = True  # otherwise the space between two lines is reported in three parts
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data

    def refuse(*_: object) -> None:
        raise UserError(f"{path}: the file declares a document type, which is not supported; remove <!DOCTYPE ...>")

    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(read_file(path), True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise UserError(f"{path}: the file is not an RSML file, because it is not valid XML ({error})") from error


def local_name(element: ET.Element) -> str:
    """Return the name of an element without its prefix, in lower case."""
    return _local(element.tag)


@lru_cache(maxsize=1024)
def _local(tag: str) -> str:
    """Return a tag without its namespace.

    Results are cached, because files have many elements but only about a dozen names.
    """
    return tag.rsplit(":", 1)[-1].lower()


def attribute(element: ET.Element, name: str) -> str | None:
    """Return an attribute by its name, ignoring case."""
    exact = element.get(name)
    return exact if exact is not None else next((value for key, value in element.attrib.items() if key.lower() == name), None)


def own_elements(root: ET.Element) -> Iterator[ET.Element]:
    """Yield the elements of a root, except the elements of its laterals."""
    stack = list(reversed(root))
    while stack:
        element = stack.pop()
        if local_name(element) != "root":
            yield element
            stack.extend(reversed(element))


def read_property(own: list[ET.Element], *names: str) -> str:
    """Return the text of the first property with one of the given names that is not empty.

    The names are compared without regard to case, hyphens and underscores (``parent-node``, ``parentNode``). The result
    is empty if there is none.
    """
    keys = [_letters(name) for name in names]
    for holder in (element for element in own if local_name(element) == "properties"):
        for child in holder:
            called = _letters(attribute(child, "name") or local_name(child))
            text = (attribute(child, "value") or child.text or "").strip()
            if called in keys and text:
                return text
    return ""


def _letters(name: str) -> str:
    return name.lower().replace("-", "").replace("_", "")
