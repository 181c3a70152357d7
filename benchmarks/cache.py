"""Cache of expensive results: rendered datasets and scores, by the content of all their inputs."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any


def folder() -> Path:
    """Return the cache folder: ``$RHIZOTWIN_CACHE``, or ``~/.cache/rhizotwin``."""
    named = os.environ.get("RHIZOTWIN_CACHE")
    return Path(named) if named else Path.home() / ".cache" / "rhizotwin"


def key(settings: dict[str, Any], *, sources: str) -> str:
    """Return the cache key of settings (JSON values) and the digest of the sources that use them."""
    text = json.dumps({"settings": settings, "sources": sources}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
