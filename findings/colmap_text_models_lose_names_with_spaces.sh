#!/bin/sh
# COLMAP's text format of models loses the names of pictures after the first space, without a word: two pictures
# "leaf 1.png" and "leaf 2.png" that COLMAP wrote itself come back with one name, "leaf". The binary format keeps them.
# Programs that match cameras and pictures by name (nerfstudio, gaussian-splatting) then find none, or the wrong one.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pycolmap==4.2.1 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import pycolmap

folder, written = Path(sys.argv[1]), ["leaf 1.png", "leaf 2.png"]
model = pycolmap.Reconstruction()
model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=1, model="PINHOLE", width=800, height=600, params=(1000, 1000, 400, 300)))
for number, name in enumerate(written, start=1):
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.0, 0.0, number]))
    model.add_image_with_trivial_frame(pycolmap.Image(image_id=number, camera_id=1, name=name), pose)
read = {}
for kind, write in (("binary", model.write_binary), ("text", model.write_text)):
    (folder / kind).mkdir()
    write(str(folder / kind))
    read[kind] = [image.name for image in pycolmap.Reconstruction(str(folder / kind)).images.values()]
print(f"pycolmap {pycolmap.__version__}: written {written}; read back from binary {sorted(read['binary'])}, from text {read['text']}")
sys.exit(sorted(read["binary"]) != written or read["text"] != ["leaf", "leaf"])
PYTHON
