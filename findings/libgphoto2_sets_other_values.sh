#!/bin/sh
# python-gphoto2 2.6.4 with libgphoto2 2.5.34 (virtual Nikon D750 of the wheel): an exposure time that the camera does
# not offer is set without error as another one. After setlocale, LANGUAGE translates even the values of settings, and
# setting the English value has no effect and no error.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet gphoto2==2.6.4
mkdir "$folder/card"
IOLIBS=$("$folder/venv/bin/python" -c "import gphoto2, pathlib; print(pathlib.Path(gphoto2.__file__).parent / 'libgphoto2' / 'vusb')")
export IOLIBS VCAMERADIR="$folder/card" LANGUAGE=de
"$folder/venv/bin/python" - <<'PYTHON'
import locale

import gphoto2


def change(camera, name, value):
    setting = camera.get_single_config(name)
    before, offered = setting.get_value(), list(setting.get_choices())
    setting.set_value(value)
    camera.set_single_config(name, setting)
    after = camera.get_single_config(name).get_value()
    print(f"{name}: {before!r} of {offered}; set to {value!r} without error; now {after!r}")
    return after, offered


print("python-gphoto2", gphoto2.__version__, "libgphoto2", gphoto2.gp_library_version(gphoto2.GP_VERSION_SHORT)[0])
camera = gphoto2.Camera()
camera.init()
time_s, times_s = change(camera, "shutterspeed", "1/3")
stored, _ = change(camera, "capturetarget", "Memory card")
print("setlocale", locale.setlocale(locale.LC_ALL, "C.UTF-8"), "with LANGUAGE=de")
translated, places = change(camera, "capturetarget", "Internal RAM")
camera.exit()
assert time_s == "0.1000s" and "1/3" not in times_s, "an exposure time that is not offered is rejected, or set to another value, now"
assert stored == "Memory card", "the English value is not set without a locale"
assert "Speicherkarte" in places and "Internal RAM" not in places, "the values of settings are not translated now"
assert translated == "Speicherkarte", "the English value is rejected, or set, now"
PYTHON
