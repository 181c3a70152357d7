"""Pictures from elsewhere: order, sizes, formats, damage and silhouettes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from rhizotwin.importer.damaged_rows import LEAST, RingPictures
from rhizotwin.importer.picture_files import list_pictures
from rhizotwin.importer.picture_import import PictureKind, import_pictures
from rhizotwin.scenes import files, frames, plan, transfer
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from tests.command import Command

WH = (64, 48)


@pytest.fixture
def scene() -> Scene:
    """Return a scene with a small camera and a plan of four views."""
    given_scene = files.load_scene("sphere_20mm")
    return replace(given_scene, camera=given_scene.camera.resized(WH), plan=CapturePlan(rings=(Ring(views=4, first_deg=10.0),)))


def picture(seed: int, *, bits: int = 8) -> np.ndarray[Any, Any]:
    return np.random.default_rng(seed).integers(0, 2**bits, (WH[1], WH[0])).astype(np.uint8 if bits == 8 else np.uint16)


def exif(values: dict[int, Any], *, orientation: int = 1) -> Image.Exif:
    said = Image.Exif()
    said[0x0112] = orientation
    said.get_ifd(0x8769).update(values)
    return said


def write_pictures(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for seed, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), picture(seed))
    return folder


def write_cameras(path: Path, names: list[str], **changed: Any) -> Path:
    """Write a transforms.json whose cameras stand round the canister, 400 mm from the axis."""
    poses = []
    for k, name in enumerate(names):
        angle = 2.0 * np.pi * k / len(names)
        cam_from_canister = frames.level_camera(distance_mm=400.0, height_mm=-40.0, tilt_deg=5.0) @ frames.rotation_z(angle)
        gl = frames.invert(cam_from_canister) @ np.diag([1.0, -1.0, -1.0, 1.0])
        poses.append({"file_path": f"images/{name}", "transform_matrix": gl.tolist()})
    lens = {"camera_model": "OPENCV", "fl_x": 100.0, "fl_y": 101.0, "cx": 32.0, "cy": 24.0, "w": WH[0], "h": WH[1], "k1": 0.01}
    given_file = {**lens, "frames": poses} | changed
    path.write_text(json.dumps({key: value for key, value in given_file.items() if value is not None}))
    return path


def test_pictures_come_in_natural_order(tmp_path: Path, scene: Scene) -> None:
    folder = write_pictures(tmp_path / "in", "view_10.png", "view_9.png", "view_1.png", "View_2.png")
    (folder / "notes.txt").touch()
    made = import_pictures(folder, scene, tmp_path / "out")
    dataset = load_dataset(tmp_path / "out")
    assert [frame.file for frame in dataset.frames] == [f"images/{name}.png" for name in ("view_1", "View_2", "view_9", "view_10")]
    assert [frame.table_deg for frame in dataset.frames] == [view.table_deg for view in plan.views(scene)] == [10.0, 100.0, 190.0, 280.0]
    assert any("table angles" in note for note in made.notes)
    np.testing.assert_array_equal(read_image(dataset, dataset.frames[3]), picture(0))


def test_every_format_is_kept_with_its_depth_and_its_word(tmp_path: Path, scene: Scene) -> None:
    folder = write_pictures(tmp_path / "in", "a.png")
    deep = picture(7, bits=16)
    cv2.imwrite(str(folder / "b.tiff"), deep, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    colour = np.full((WH[1], WH[0], 3), (40, 200, 10), np.uint8)
    Image.fromarray(colour).save(folder / "c.jpg", exif=exif({0xA500: 1.0}))  # gamma
    Image.fromarray(picture(1)).save(folder / "d.jpg", exif=exif({0xA001: 1}), quality=100)  # sRGB
    made = import_pictures(folder, scene, tmp_path / "out")
    kept, given_files = ({path.name: path.read_bytes() for path in own.iterdir()} for own in (tmp_path / "out/images", folder))
    assert kept == given_files
    np.testing.assert_array_equal(read_image(made.dataset, made.dataset.frames[1]), deep)
    grey = read_image(made.dataset, made.dataset.frames[2])
    assert np.abs(grey.astype(float) - (0.114 * 10 + 0.587 * 200 + 0.299 * 40)).max() < 4.0
    light = read_image(made.dataset, made.dataset.frames[3]) / 65535.0
    np.testing.assert_allclose(light, transfer.SRGB.of(picture(1) / 255.0), atol=0.03)
    assert any("sRGB" in note for note in made.notes)


def test_silent_jpegs_are_assumed_to_be_srgb(tmp_path: Path, scene: Scene) -> None:
    folder = write_pictures(tmp_path / "in", "a.jpg", "b.jpg")
    Image.fromarray(np.rot90(picture(0))).save(folder / "b.jpg", exif=exif({}, orientation=6), quality=100)
    made = import_pictures(folder, scene, tmp_path / "out")
    light = read_image(made.dataset, made.dataset.frames[1]) / 65535.0
    np.testing.assert_allclose(light, transfer.SRGB.of(picture(0) / 255.0), atol=0.03)
    said = " ".join(made.notes)
    assert "sRGB is assumed for 2 JPEG pictures" in said
    assert "6: 1 picture, turned clockwise by 90 degrees). The tags differ" in said
    table = replace(scene, camera=replace(scene.camera, transfer="table", transfer_table=(0.0, 1.0)))
    assert import_pictures(folder, table, tmp_path / "linear").dataset.scene == table
    assert cv2.imwrite(str(folder / "c.png"), picture(0))
    with pytest.raises(UserError, match=r"a\.jpg and .*c\.png state no response curve.*one format"):
        import_pictures(folder, scene, tmp_path / "mixed")


def test_damage_without_a_checksum_is_shown_by_neighbours(tmp_path: Path, scene: Scene) -> None:
    (tmp_path / "in").mkdir()
    for k in range(6):
        grey = np.random.default_rng(k).normal(180.0, 2.0, WH[::-1]).astype(np.uint8)
        if k == 3:
            grey[20:30] = 0
        cv2.imwrite(str(tmp_path / "in" / f"v{k}.tif"), grey, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    with pytest.raises(UserError, match=r"v3\.tif: rows (18|19|20) to 29 differ from all other pictures.*whose checksum"):
        import_pictures(tmp_path / "in", scene, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "in" / "v3.tif").unlink()
    assert any("without a checksum" in note for note in import_pictures(tmp_path / "in", scene, tmp_path / "out").notes)


def test_pictures_without_a_camera_or_name_of_their_own(tmp_path: Path, scene: Scene) -> None:
    cameras = write_cameras(tmp_path / "transforms.json", ["a.png", "c"])
    folder = write_pictures(tmp_path / "in", "a.png", "b.png", "c.png")
    made = import_pictures(folder, scene, tmp_path / "out", kind=PictureKind(cameras=cameras))
    assert [frame.file for frame in made.dataset.frames] == ["images/a.png", "images/c.png"]
    assert any("b.png" in note for note in made.notes)
    assert cv2.imwrite(str(folder / "a.jpg"), picture(0))
    with pytest.raises(UserError, match=r"a\.jpg and a\.png, whose names differ only in the suffix"):
        list_pictures(folder)


ROOTS = np.zeros((WH[1], WH[0]), np.uint8)
ROOTS[10:40, 5:12] = ROOTS[10:30, 30:33] = 255
LABELS = np.where(np.arange(WH[0]) < 20, ROOTS // 2, ROOTS)
OPAQUE = np.full_like(ROOTS, 255)


def import_masks(folder: Path, scene: Scene, **masks: np.ndarray[Any, Any]) -> Dataset:
    """Import silhouettes, keyed by name. Those with two channels are a grey colour and its transparency."""
    (folder / "in").mkdir()
    for name, mask in masks.items():
        image = np.dstack([mask[..., :1]] * 3 + [mask[..., 1:]]) if mask.ndim == 3 else mask
        assert cv2.imwrite(str(folder / "in" / f"{name}.png"), image)
    cameras = write_cameras(folder / "transforms.json", list(masks))
    return import_pictures(folder / "in", scene, folder / "out", kind=PictureKind(cameras=cameras, masks=True)).dataset


MASKS = {
    "zero and one": ROOTS // 255,
    "16 bits": ROOTS.astype(np.uint16) * 257,
    "of a video": 16 + ROOTS // 255 * np.uint8(219),
    "transparent background": np.dstack([ROOTS, ROOTS]),
}


@pytest.mark.parametrize("roots", MASKS.values(), ids=MASKS.keys())
def test_masks_are_stretched(roots: np.ndarray[Any, Any], tmp_path: Path, scene: Scene) -> None:
    made = import_masks(tmp_path, scene, a=roots)
    assert load_dataset(made.folder).masks
    np.testing.assert_array_equal(read_image(made, made.frames[0]), ROOTS)


NO_MASKS: dict[str, tuple[np.ndarray[Any, Any], str]] = {
    "inverted": (255 - ROOTS, "100 % of its border are white"),
    "large and inverted": (np.pad(np.zeros((44, 52), np.uint8), ((0, 4), (6, 6)), constant_values=255), "76 % of its border"),
    "white with alpha": (np.dstack([OPAQUE, ROOTS]), "in the transparency"),
    "black with alpha": (np.dstack([0 * ROOTS, ROOTS]), "in the transparency"),
    "black": (0 * ROOTS, "is completely black"),
    "labels": (LABELS, "labels of roots"),
    "thin labels": (np.where(np.arange(WH[0]) % 2 == 0, LABELS, 0).astype(np.uint8), "labels of roots"),
    "grey background": (np.maximum(ROOTS, 100), "its background is grey"),
    "photograph": (picture(1) // 2 * ROOTS.clip(0, 1) + ROOTS // 9, "neither black nor white"),
    "another white": (ROOTS // 255, "have the value 1, but white has the value 255"),
    "half as white": (ROOTS // 2 + 1, "have the value 128, but"),
}


@pytest.mark.parametrize(("mask", "named"), NO_MASKS.values(), ids=NO_MASKS.keys())
def test_impossible_masks_are_refused_by_name(mask: np.ndarray[Any, Any], named: str, tmp_path: Path, scene: Scene) -> None:
    with pytest.raises(UserError, match=rf"/b\.png.*{named}"):
        import_masks(tmp_path, scene, a=ROOTS, b=mask)
    assert not (tmp_path / "out").exists()


def test_command_imports_and_says_what_it_assumed(tmp_path: Path, scene: Scene, command: Command) -> None:
    files.save_scene(scene, tmp_path / "rig.toml")
    good = np.random.default_rng(0).integers(100, 200, (WH[1], WH[0]), dtype=np.uint8)
    write_image(tmp_path / "in" / "a.png", good)
    write_image(tmp_path / "in" / "b.png", np.where(np.arange(WH[1])[:, None] < WH[1] // 2, np.uint8(255), good))
    words = ("import", tmp_path / "in", "--scene", tmp_path / "rig.toml", "-o", tmp_path / "out")
    done = command.works(*words)
    assert "table angles will be estimated" in done.out  # the plan has four
    assert "1 of 2 pictures are overexposed; the worst is images/b.png with 50 %" in done.out + done.err
    made = load_dataset(tmp_path / "out")
    assert [frame.table_deg for frame in made.frames] == [None, None]
    assert list(made.origin["clipped"]) == ["images/b.png"]
    command.fails(*words, named=["not empty", "choose another name"])


def test_pictures_in_bands_are_views_by_the_ends_of_their_names(scene: Scene, tmp_path: Path) -> None:
    bands = (Band(name="white"), Band(name="nir", wavelength_nm=850.0, panel_level=0.0))
    banded = replace(scene, camera=replace(scene.camera, bands=bands), plan=CapturePlan(rings=(Ring(views=2, first_deg=10.0),)))
    pictures = write_pictures(tmp_path / "p", "b_2_nir.png", "b_2_white.png", "b_10_nir.png", "b_10_white.png")
    made = import_pictures(pictures, scene=banded, out=tmp_path / "d").dataset
    expected = [(0, "nir", 10.0), (0, "white", 10.0), (1, "nir", 190.0), (1, "white", 190.0)]
    assert [(frame.view, frame.band, frame.table_deg) for frame in made.frames] == expected


HIGH, WIDE = 120, 160


def turn(count: int, *, spoilt: slice = slice(0)) -> RingPictures:
    """Return pictures of a bright panel before which three thin things turn, with noise; the third picture is spoilt."""
    rng, made = np.random.default_rng(0), RingPictures()
    for k in range(count):
        light = np.full((HIGH, WIDE), 190.0)
        for radius, phase in ((10.0, 0.0), (35.0, 2.0), (60.0, 4.0)):
            x = round(WIDE / 2.0 + radius * np.cos(2.0 * np.pi * k / count + phase))
            light[20:, x - 1 : x + 2] = 20.0
        taken = np.clip(light + rng.normal(0.0, 2.0, light.shape), 0, 255).astype(np.uint8)
        taken[spoilt if k == 2 else slice(0)] = 0
        made.add(Path(f"view_{k}.tif"), taken)
    return made


def test_black_rows_are_found_where_they_are_and_nothing_else() -> None:
    (thin,), (wide,) = (turn(12, spoilt=rows).find_damaged() for rows in (slice(40, 41), slice(14, 120)))
    assert (thin.path, thin.last, wide.last) == (Path("view_2.tif"), 40, 119)
    assert max(abs(thin.first - 40), abs(wide.first - 14)) <= 2
    assert turn(12).find_damaged() == turn(12, spoilt=slice(0, HIGH)).find_damaged() == []  # the latter is another light
    few = turn(LEAST - 1, spoilt=slice(40, 60))
    assert not few.enough
    assert few.find_damaged() == []


def test_vessels_and_lights_that_are_not_supported(tmp_path: Path, scene: Scene) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for k in range(4):
        image = np.full((WH[1], WH[0]), 2, np.uint8)  # roots and strip, bright on dark ground
        image[:10], image[20:40, 30 + k] = 160, 90
        cv2.imwrite(str(folder / f"{k}.png"), image)
    box = replace(scene, canister=replace(scene.canister, half_width_mm=80.0))
    side = replace(scene, lights=replace(scene.lights, side_level=0.5))
    for one, said in ((box, "rectangular vessels .* are not supported"), (side, "lit from the side .* are not supported")):
        with pytest.raises(UserError, match=said):
            import_pictures(folder, one, tmp_path / "out")
    with pytest.raises(UserError, match=r"png: the ground is dark \(1 % of the brightest parts\).*dark field.*or the panel was off"):
        import_pictures(folder, scene, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    banded = replace(scene, camera=replace(scene.camera, bands=(Band(name="uv", panel_level=0.0), Band(name="white"))))
    for k in range(4):
        (folder / f"{k}.png").rename(folder / f"{k}_uv.png")
        cv2.imwrite(str(folder / f"{k}_white.png"), picture(k))
    assert len(import_pictures(folder, banded, tmp_path / "out").dataset.frames) == 8
