"""python-gphoto2 is stood in for by the twin's emulation; the library itself is used with its virtual camera where it is installed."""

import importlib.util
import os
import subprocess
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.cameras.gphoto import GphotoCamera
from rhizotwin.rig.cameras.gphoto_locks import parse_number
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import CameraPart, RigFile, load_rig
from rhizotwin.rig.scanning.markers import read_strip
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.twin.gphoto_library import EmulatedBody, EmulatedLibrary, Setting
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring
from rhizotwin.scenes.transfer import SRGB
from tests.rig.fake_devices import CLEAN, opened
from tests.rig.fake_time import Time

SETTINGS = CameraSettings(image_wh=(40, 30), bits=12, exposure_s=0.008, gain=2.0, f_number=8.0)
LIGHT = np.linspace(400, 3600, 1200).reshape(30, 40).astype(np.uint16)


@pytest.fixture
def body() -> EmulatedBody:
    return EmulatedBody(look=lambda exposure: np.rint(exposure * LIGHT).astype(np.uint16) << 4, clock=Time(), nominal_s=0.016)


def camera_of(body: EmulatedBody, settings: CameraSettings = SETTINGS, *, on_board: bool = False) -> GphotoCamera:
    return GphotoCamera("0", settings, clock=body.clock, on_board=on_board, library=EmulatedLibrary(body))


def test_settings_are_fixed_and_raw_files_are_the_light(body: EmulatedBody) -> None:
    camera = camera_of(body)
    camera.prepare()
    shot = camera.capture()
    np.testing.assert_array_equal(shot.image, LIGHT << 4)
    assert (shot.exposure_s, shot.gain) == (0.008, 2.0)
    assert {name: setting.value for name, setting in body.settings.items()} == {
        "autoexposuremode": "Manual",
        "shutterspeed": "1/125",
        "iso": "200",
        "aperture": "8",
        "focusmode": "Manual",
        "whitebalance": "Daylight",
        "capturetarget": "Internal RAM",
        "imageformat": "RAW",
    }
    assert not body.files  # the camera's memory does not fill up
    assert camera.describe().startswith("Canon EOS 80D (camera 0), 40x30 from raw files, 8 ms, ISO 200")


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("focusmode", {"value": "One Shot"}, r"focus mode is One Shot instead of manual \(switch the lens or the body to MF\)"),
        ("autoexposuremode", {"value": "AV"}, "exposure mode is AV instead of M"),
        ("shutterspeed", {"choices": ("1/60", "1/250")}, r"exposure time is 1/60 instead of 0.008 s, available: 1/60, 1/250 \(set exp"),
        ("iso", {"stuck": True}, "ISO is Auto instead of 200"),
        ("aperture", {"stuck": True}, "aperture is 5.6 instead of f/8"),
        ("aperture", {"choices": ()}, "aperture is 5.6 instead of f/8"),
        ("imageformat", {"choices": ("Large Fine JPEG",)}, "file format is Large Fine JPEG instead of raw"),
    ],
)
def test_what_cannot_be_fixed_is_refused(body: EmulatedBody, name: str, change: dict[str, object], said: str) -> None:
    body.settings[name] = replace(body.settings[name], **change)
    with pytest.raises(RigError, match=said):
        camera_of(body).prepare()
    assert body.released == 0
    del body.settings["focusmode"]
    with pytest.raises(RigError, match="does not report the focus mode"):
        camera_of(body).prepare()


def test_a_card_and_another_white_balance_suit_raw_files(body: EmulatedBody) -> None:
    body.settings["capturetarget"] = Setting("card", ("card", "card+sdram"))
    body.settings["whitebalance"] = Setting("Tungsten", ("Auto", "Tungsten"), stuck=True)
    camera_of(body).prepare()
    with pytest.raises(RigError, match="white balance is Tungsten instead of Daylight"):
        camera_of(body, replace(SETTINGS, linear=False, bits=8)).prepare()


def test_settings_that_change_during_a_scan_are_refused(body: EmulatedBody) -> None:
    camera = camera_of(body, replace(SETTINGS, f_number=None))
    camera.prepare()
    body.settings["aperture"].value = "11"
    with pytest.raises(RigError, match=r"aperture is 11 instead of 5\.6"):
        camera.capture()


def test_jpeg_files_need_a_curve(body: EmulatedBody) -> None:
    curved = replace(SETTINGS, linear=False, bits=8)
    camera = camera_of(body, curved)
    camera.prepare()
    light = SRGB.of(camera.capture().image / 255.0)
    assert light == pytest.approx(LIGHT / 4095.0, abs=0.02)  # lossy
    with pytest.raises(RigError, match="JPEG files have 8 bits, not 12"):
        camera_of(body, replace(curved, bits=12)).prepare()
    camera._settings = SETTINGS
    with pytest.raises(RigError, match=r"is a JPEG, which is not linear .* calibrate transfer"):
        camera.capture()


def test_lost_busy_and_missing_cameras(body: EmulatedBody) -> None:
    camera = camera_of(body)
    camera.prepare()
    body.connected = False
    with pytest.raises(RigError, match="could not be triggered"):
        camera.capture()
    with pytest.raises(RigError, match=r"no such camera \(found: none\)"):
        camera.prepare()
    body.connected, body.in_use = True, True
    with pytest.raises(RigError, match=r"Could not claim the USB device.*gvfs"):
        camera.prepare()
    body.in_use = False
    with pytest.raises(RigError, match="80x60 pixels, which is not an even multiple"):
        camera_of(body, replace(SETTINGS, image_wh=(41, 30))).prepare()
    with pytest.raises(RigError, match="neither the number of a camera nor a port"):
        GphotoCamera("first", SETTINGS, clock=body.clock, library=EmulatedLibrary(body))


@pytest.mark.parametrize("pin", [None, 60])
def test_the_board_releases_the_shutter(pin: int | None) -> None:
    part = CameraPart(kind="gphoto2", trigger="board", trigger_pin=pin)
    twin = Twin(CLEAN, profile_name="clean", pictures="sketch", rig=RigFile(camera=part))
    with opened(twin) as devices:
        devices.table.prepare()
        devices.lights.set(panel=1.0, front=1.0)
        devices.camera.prepare()
        shot = devices.camera.capture()
        np.testing.assert_array_equal(shot.image, twin.look())
        assert read_strip(shot.image, CLEAN) is not None
        twin.board.commands.shutter = lambda _: None  # a broken cable
        with pytest.raises(RigError, match=r"no picture arrived within 20 s .* check the shutter cable"):
            devices.camera.capture()


def test_an_interrupted_scan_resumes(tmp_path: Path) -> None:
    scene = replace(CLEAN, plan=CapturePlan(rings=(Ring(views=4),)))
    rig = RigFile(camera=CameraPart(kind="gphoto2"))

    def scan_with(stop_at: int, **options: bool) -> Dataset:
        twin = Twin(scene, profile_name="clean", pictures="sketch", rig=rig)
        camera, taken = twin.open_camera(), count(1)
        capture = camera.capture

        def interrupted() -> Shot:
            if next(taken) == stop_at:
                raise KeyboardInterrupt
            return capture()

        camera.capture = Mock(side_effect=interrupted)
        with opened(twin, camera=camera) as devices:
            return scan(devices, twin.calibrated_scene(), tmp_path / "d", observers=Observers(say=lambda _: None), **options)

    with pytest.raises(KeyboardInterrupt):
        scan_with(7)
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "d").rglob("view_*.png")}
    assert before
    made = scan_with(0, resume=True)
    assert [frame.table_deg for frame in made.frames] == [0.0, 90.0, 180.0, 270.0]
    assert before.items() <= {path.name: path.stat().st_mtime_ns for path in made.folder.rglob("view_*.png")}.items()


def test_triggers_of_a_rig_file(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[camera]\ntrigger = "board"\n', encoding="utf-8")
    with pytest.raises(UserError, match="possible only for kind gphoto2"):
        load_rig(path)
    path.write_text('[turntable]\nkind = "hat"\n[camera]\nkind = "gphoto2"\ntrigger = "board"\ntrigger_pin = 23\n', encoding="utf-8")
    with pytest.raises(UserError, match="not used in"):
        load_rig(path)


def test_numbers_of_the_library() -> None:
    numbers = {"1/125": 0.008, "0.0080s": 0.008, "f/5.6": 5.6, "30": 30.0, "Auto": None, "1/0": None}
    assert {value: parse_number(value) for value in numbers} == pytest.approx(numbers)


def test_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    with pytest.raises(RigError, match="pip install"):
        open_camera(CameraPart(kind="gphoto2"), image_wh=(40, 30), bits=12, clock=SystemClock())


VIRTUAL = """
import locale
locale.setlocale(locale.LC_ALL, "C.UTF-8")
from rhizotwin.rig.cameras.gphoto import GphotoCamera
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import RigError
camera = GphotoCamera("0", CameraSettings(exposure_s=0.02, f_number=8.0), clock=SystemClock())
try:
    camera.prepare()
except RigError as error:
    print(error)
camera._check_locks = lambda: None
camera._guard("opened", camera._open)
print([camera._camera.get_single_config(name).get_value() for name in ("shutterspeed", "f-number", "autofocus", "capturetarget")])
print(camera._take()[:3].hex(), camera._take()[:3].hex())
"""


@pytest.mark.skipif(importlib.util.find_spec("gphoto2") is None, reason="python-gphoto2 is not installed")
def test_the_library_itself_with_its_virtual_camera(tmp_path: Path) -> None:
    """libgphoto2's own virtual PTP camera has exposure and aperture, but neither ISO nor focus: it is refused, but obeys."""
    import cv2

    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((48, 64), 90, np.uint8))
    folder = Path(str(importlib.util.find_spec("gphoto2").origin)).parent / "libgphoto2" / "vusb"
    env = os.environ | {"IOLIBS": str(folder), "VCAMERADIR": str(tmp_path), "LANGUAGE": "de"}
    made = subprocess.run([sys.executable, "-c", VIRTUAL], env=env, capture_output=True, text=True, timeout=60, check=False)
    assert "does not report the ISO" in made.stdout, made.stderr
    assert "does not report the focus mode" in made.stdout
    assert made.stdout.splitlines()[1:] == ["['0.0200s', 'f/8', 'Off', 'Internal RAM']", "ffd8ff ffd8ff"]
