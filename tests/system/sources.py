"""Every source file that is no test."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_FOLDERS = ("benchmarks", "recon", "rhizotwin", "rig", "scenes", "sim")
_LINKS = tuple(f"rhizotwin/{folder}/" for folder in _FOLDERS)
_ALL = (str(path.relative_to(ROOT)) for folder in _FOLDERS for path in (ROOT / folder).rglob("*.py"))
FILES = sorted(file for file in _ALL if not file.startswith(_LINKS))
