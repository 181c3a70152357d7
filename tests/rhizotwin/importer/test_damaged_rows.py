"""Rows that no other picture of the turn has."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.importer.damaged_rows import LEAST, RingPictures

HIGH, WIDE = 120, 160


def view(angle_deg: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a bright panel before which a few thin things turn, with noise."""
    light = np.full((HIGH, WIDE), 190.0)
    for radius, phase in ((10.0, 0.0), (35.0, 2.0), (60.0, 4.0)):
        x = WIDE / 2.0 + radius * np.cos(np.deg2rad(angle_deg) + phase)
        light[20:, round(x) - 1 : round(x) + 2] = 20.0
    return np.clip(light + rng.normal(0.0, 2.0, light.shape), 0, 255).astype(np.uint8)


def turn(count: int, *, spoilt: slice | None = None) -> RingPictures:
    rng, made = np.random.default_rng(0), RingPictures()
    for k in range(count):
        picture = view(360.0 * k / count, rng)
        if spoilt is not None and k == 2:
            picture[spoilt] = 0
        made.add(Path(f"view_{k}.tif"), picture)
    return made


def test_whole_pictures_are_like_each_other() -> None:
    assert turn(12).find_damaged() == []
    assert turn(12).excess().max() < 0.1


def test_black_rows_are_found_where_they_are() -> None:
    for rows in (slice(40, 41), slice(100, 120), slice(0, 14), slice(14, 120)):
        (found,) = turn(12, spoilt=rows).find_damaged()
        assert found.path == Path("view_2.tif")
        assert abs(found.first - rows.start) <= 2
        assert found.last == rows.stop - 1


def test_another_light_is_no_damage() -> None:
    assert turn(12, spoilt=slice(0, HIGH)).find_damaged() == []


def test_few_pictures_cannot_tell() -> None:
    few = turn(LEAST - 1, spoilt=slice(40, 60))
    assert not few.enough
    assert few.find_damaged() == []
