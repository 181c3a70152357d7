"""Conversion of plain dicts to TOML text, from which `tomllib` reads the same values."""

import json
import re
from collections.abc import Mapping
from typing import Any


def dumps(table: Mapping[str, Any]) -> str:
    """Format a dict of scalars, lists of scalars, dicts, and lists of dicts as TOML.

    Raises
    ------
    TypeError
        If a value is not supported by TOML, such as None.
    """
    return "\n".join(_table(table, "")).strip("\n") + "\n"


def _table(table: Mapping[str, Any], prefix: str) -> list[str]:
    """Return the lines of a table: first its own keys, then its subtables."""
    lines = [f"{_key(key)} = {value(item)}" for key, item in table.items() if not _is_table(item) and not _is_tables(item)]
    for key, inner in table.items():
        name = f"{prefix}{_key(key)}"
        if _is_table(inner):
            lines += ["", f"[{name}]", *_table(inner, f"{name}.")]
        elif _is_tables(inner):
            for item in inner:
                lines += ["", f"[[{name}]]", *_table(item, f"{name}.")]
    return lines


def _key(key: str) -> str:
    """Return a key, quoted if TOML requires quotes."""
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else value(key)


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_tables(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def value(given: Any) -> str:
    """Format a scalar or a list as TOML.

    Floats are formatted by Python, whose shortest representation is exact, and is valid TOML.
    """
    if isinstance(given, bool):
        return "true" if given else "false"
    if isinstance(given, (int, float)):
        return repr(float(given) if isinstance(given, float) else int(given))
    if isinstance(given, str):  # escapes of JSON are valid in TOML, except for DEL
        return json.dumps(given, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(given, (list, tuple)):
        return "[" + ", ".join(value(item) for item in given) + "]"
    raise TypeError(f"TOML does not support {type(given).__name__}")
