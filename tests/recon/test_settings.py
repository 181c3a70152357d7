"""Settings from a file, and what is refused."""

from pathlib import Path

import pytest

from rhizotwin.recon.settings import Settings, load_settings
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain, to_plain


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_a_file_leaves_out_has_its_default(tmp_path: Path) -> None:
    found = load_settings(written(tmp_path, "voxel_mm = 0.2\n[hull]\nfinest_mm = 0.1\n"))
    assert found.voxel_mm == 0.2
    assert found.hull.finest_mm == 0.1
    assert found.hull.slack_px == Settings().hull.slack_px
    assert found.roots == Settings().roots


def test_what_a_result_records_gives_the_same_settings() -> None:
    chosen = Settings(voxel_mm=0.5)
    assert from_plain(Settings, to_plain(chosen), Place("result.json")) == chosen


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("voxel_mn = 0.2", 'did you mean "voxel_mm"'),
        ("[hull]\nfinest_mm = 0", r"line 2: \[hull\] finest_mm = 0"),
        ("[hull]\nslack_px = true", "must be a number"),
        ("voxel_mm = ", "not readable TOML"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(tmp_path: Path, text: str, named: str) -> None:
    with pytest.raises(UserError, match=named):
        load_settings(written(tmp_path, text))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        load_settings(tmp_path / "none.toml")
