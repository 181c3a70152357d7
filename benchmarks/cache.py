"""Rendered datasets, kept by the content of everything that went into them: a changed source or scene is another folder."""

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("sim", "scenes")
"""Packages whose every file goes into the key."""


def folder() -> Path:
    """Return the cache folder: ``$RHIZOTWIN_CACHE``, or ``~/.cache/rhizotwin``."""
    named = os.environ.get("RHIZOTWIN_CACHE")
    return Path(named) if named else Path.home() / ".cache" / "rhizotwin"


def source_digest(root: Path = ROOT, packages: Sequence[str] = SOURCES) -> str:
    """Return one SHA-256 over the names and contents of all source and data files of the packages."""
    digest = hashlib.sha256()
    for package in packages:
        files = [path for path in sorted((root / package).rglob("*")) if path.is_file() and "__pycache__" not in path.parts]
        if not files:
            raise FileNotFoundError(f"{root / package} holds no files, so the cache cannot tell whether they changed")
        for path in files:
            content = path.read_bytes()
            digest.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()


def key(settings: dict[str, Any], *, sources: str) -> str:
    """Return a dataset's key from its settings (JSON values) and the digest of the sources."""
    text = json.dumps({"settings": settings, "sources": sources}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
