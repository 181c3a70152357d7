"""Bands on the emulated rig: lamps, outputs and filter of each, a scan in all of them, and what is taken again."""

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.rig.devices import Shot
from rhizotwin.rig.rig_file import ArmPart, BandPart, Joint, RigFile, check_rig
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.twin.faults import Fault
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.dataset import Dataset, load_dataset, read_image
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.schema import Place
from tests.rig.fake_devices import LENS, STRIP, World, devices, run, scan_twin

BANDS = (Band(name="red", wavelength_nm=670.0, panel_level=0.0), Band(name="white"), Band(name="nir", wavelength_nm=850.0))
SCENE = Scene(
    camera=replace(LENS, bands=BANDS),
    strip=STRIP,
    plan=CapturePlan(rings=(Ring(views=2, height_mm=-20.0), Ring(views=2, height_mm=0.0, bands=("white",)))),
)
WHEEL = ArmPart(filter=Joint(servo=1, min_deg=-90.0, max_deg=90.0))
RIG = RigFile(
    arm=WHEEL,
    camera=replace(
        default_rig().camera,
        bands=(
            BandPart(name="red", panel_level=0.0, front_rgb=(255, 0, 0), filter_deg=-45.0),
            BandPart(name="white", filter_deg=45.0),
            BandPart(name="nir", panel_level=0.0, front_level=0.0, output=2, filter_deg=45.0),
        ),
    ),
)


def bands_shown(twin: Twin, dataset: Dataset) -> list[tuple[str, str]]:
    """Return the band of each frame and the one that lamps and filter were set for when its picture was taken."""
    return [(frame.band, twin.record.shot_of(read_image(dataset, frame)).sight.band) for frame in dataset.frames]


def twin_of(*faults: Fault, profile: str = "bench") -> Twin:
    return Twin(SCENE, seed=1, profile_name=profile, pictures="sketch", rig=RIG, faults=faults)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Twin, Dataset]:
    twin = twin_of()
    return twin, scan_twin(twin, tmp_path_factory.mktemp("whole") / "d")


@pytest.mark.slow
def test_every_view_in_its_bands_and_missing_ones_again(whole: tuple[Twin, Dataset], tmp_path: Path) -> None:
    twin, made = whole
    assert [(frame.view, frame.band) for frame in made.frames] == [
        *((view, band) for view in (0, 1) for band in ("red", "white", "nir")),
        (2, "white"),
        (3, "white"),
    ]
    assert load_dataset(made.folder) == made
    views = {frame.view: frame.table_read_deg for frame in made.frames}
    assert all(frame.table_read_deg == views[frame.view] for frame in made.frames), "the table stands still for all bands of a view"
    assert not twin.world.outputs_on
    assert all(set_for == band for band, set_for in bands_shown(twin, made))
    folder = Path(shutil.copytree(made.folder, tmp_path / "d"))
    (folder / "images" / "view_001_nir.png").unlink()
    again = scan_twin(twin, folder, resume=True)
    assert [frame.file for frame in again.frames] == [frame.file for frame in made.frames]
    assert again.frames[0].sha256 == made.frames[0].sha256


@pytest.mark.slow
def test_a_reset_in_red_is_recovered_in_the_band_of_the_markers(whole: tuple[Twin, Dataset], tmp_path: Path) -> None:
    times = {frame.file: frame.time_s for frame in whole[1].frames}
    in_red = 0.5 * (times["images/view_001_white.png"] + times["images/view_001_red.png"])
    twin = twin_of(Fault(kind="reset", device="table", at_s=in_red))
    made = scan_twin(twin, tmp_path / "d")
    assert twin.pending.happened
    assert [frame.file for frame in made.frames] == list(times)
    assert made.frames[4].placement == 1, "the angle was found anew before the view was taken again"
    assert set(bands_shown(twin, made)) == {(name, name) for name in ("red", "white", "nir")}


@pytest.mark.parametrize("change", [2, 3])
def test_an_old_picture_is_not_stored_as_that_of_another_band(change: int, tmp_path: Path) -> None:
    """After one of the changes of band in two views, the camera delivers the picture before the change once more."""
    names = ("white", "red", "nir")
    scene = replace(SCENE, camera=replace(LENS, bands=tuple(Band(name=name) for name in names)), plan=CapturePlan(rings=(Ring(views=2),)))
    world, rng, taken = World(scene=scene), np.random.default_rng(5), list[tuple[str, np.ndarray]]()
    late = replace(devices(world), rig=RigFile(arm=None, camera=replace(RIG.camera, bands=tuple(BandPart(name=name) for name in names))))
    capture = late.camera.capture

    def capture_late() -> Shot:
        shot = capture()
        taken.append((world.band, np.clip(shot.image + rng.normal(0.0, 500.0, shot.image.shape), 0.0, 65535.0).astype(np.uint16)))
        changed = [before != after for (before, _), (after, _) in pairwise(taken)]
        return replace(shot, image=taken[-2 if changed[-1:] == [True] and sum(changed) == change else -1][1])

    late.camera.capture = capture_late
    made = scan(late, scene, tmp_path / "d", observers=Observers(say=lambda _: None))
    assert made.origin["complete"]
    for frame in made.frames:
        assert any(band == frame.band and np.array_equal(image, read_image(made, frame)) for band, image in taken), frame.file
    assert any("identical" in event["text"] for event in made.origin["log"])


def test_a_scene_with_a_band_that_the_rig_lacks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"has the band 'red'.*add \[\[camera.bands\]\] with name = \"red\""):
        run(World(scene=SCENE), tmp_path / "d")


HAT = RIG.hat
WRONG = {
    "no wheel": (replace(RIG, arm=ArmPart()), r"filter_deg = -45.0.*requires the section \[arm.filter\]"),
    "a pin in use": (
        replace(
            RIG,
            turntable=replace(RIG.turntable, kind="hat"),
            camera=replace(RIG.camera, bands=(BandPart(name="nir", output=HAT.step_pin),)),
        ),
        r"output = 23.*must not be a pin that is used in \[hat\]",
    ),
}


@pytest.mark.parametrize(("rig", "says"), WRONG.values(), ids=WRONG)
def test_bands_that_the_rig_cannot_set_are_refused(rig: RigFile, says: str) -> None:
    check_rig(RIG, Place("rig"))
    with pytest.raises(UserError, match=says):
        check_rig(rig, Place("rig"))
