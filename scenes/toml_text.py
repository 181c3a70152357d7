"""Plain dicts to TOML text; `tomllib` reads it back to the same values."""

import json
from collections.abc import Mapping
from typing import Any


def dumps(table: Mapping[str, Any]) -> str:
    """Return TOML for a dict of scalars, lists of scalars, dicts, and lists of dicts.

    Raises
    ------
    TypeError
        For a value that TOML cannot hold (None among them).
    """
    return "\n".join(_table(table, "")).strip("\n") + "\n"


def _table(table: Mapping[str, Any], prefix: str) -> list[str]:
    """Return the lines of one table: its own keys first, then the tables in it."""
    lines = [f"{key} = {_value(value)}" for key, value in table.items() if not _is_table(value) and not _is_tables(value)]
    for key, value in table.items():
        name = f"{prefix}{key}"
        if _is_table(value):
            lines += ["", f"[{name}]", *_table(value, f"{name}.")]
        elif _is_tables(value):
            for item in value:
                lines += ["", f"[[{name}]]", *_table(item, f"{name}.")]
    return lines


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_tables(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def _value(value: Any) -> str:
    """Return one TOML scalar or list; Python's shortest float text is exact and valid TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(float(value) if isinstance(value, float) else int(value))
    if isinstance(value, str):  # JSON's escapes are TOML's, but for DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    raise TypeError(f"TOML cannot hold {type(value).__name__}")
