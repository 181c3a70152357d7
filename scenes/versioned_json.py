"""JSON files that state the version of their format."""

import json
from pathlib import Path
from typing import Any

from rhizotwin.scenes.errors import UserError, parser_message
from rhizotwin.scenes.reading import decode_text, read_file


def read_versioned_json(path: Path, version: int) -> dict[str, Any]:
    """Read a JSON file with a ``schema_version``, see `parse_versioned_json`."""
    return parse_versioned_json(read_file(path), path, version)


def parse_versioned_json(data: bytes, path: Path, version: int) -> dict[str, Any]:
    """Parse the content of a JSON file with a ``schema_version``.

    Parameters
    ----------
    data : bytes
        Content of the file.
    path : Path
        Path, used in messages.
    version : int
        Supported version.

    Returns
    -------
    dict
        Complete JSON object.

    Raises
    ------
    UserError
        If the file is damaged, or has another version.
    """
    try:
        mapping = json.loads(decode_text(data, path))
    except (ValueError, RecursionError) as error:
        raise UserError(
            f"{path}: the file is damaged, because it is not valid JSON ({parser_message(error)}); restore it or create it again"
        ) from error
    if not isinstance(mapping, dict):
        raise UserError(f"{path}: the file is damaged, because it is not a JSON object; restore it or create it again")
    found = mapping.get("schema_version")
    if type(found) is not int or found != version:
        known = f"has version {found}" if "schema_version" in mapping else "has no schema_version"
        raise UserError(
            f"{path.name} {known}, but this program reads version {version}; use the program version that wrote the file, or create it "
            f"again ({path})"
        )
    return mapping
