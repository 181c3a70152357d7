#!/bin/sh
# CPlantBox 2.1.1: Plant.write("x.rsml"), the class that replaces the deprecated RootSystem, writes a scene without roots.
# RootSystem.write writes laterals without their first point: the lines of the file are shorter than the simulated roots.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet cplantbox==2.1.1 numpy==2.4.6 scipy matplotlib
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version
from pathlib import Path
import numpy as np
import plantbox as pb
from plantbox.rsml import rsml_reader

parameters = Path(pb.__file__).parent / "modelparameter/structural/rootsystem/Anagallis_femina_Leitner_2010.xml"


def simulate(plant, *quiet):
    plant.readParameters(str(parameters))
    plant.setSeed(1)
    plant.initialize(*quiet)
    plant.simulate(10.0, False)
    return plant


def length(lines):
    return sum(np.linalg.norm(np.diff(np.array(line), axis=0), axis=1).sum() for line in lines)


found = {}
for name, plant in (("Plant", simulate(pb.Plant(), False)), ("RootSystem", simulate(pb.RootSystem()))):
    roots = [[[p.x, p.y, p.z] for p in organ.getNodes()] for organ in plant.getOrgans() if organ.organType() == 2]
    plant.write(f"{name}.rsml")
    lines = rsml_reader.read_rsml(f"{name}.rsml")[0]
    found[name] = len(roots), len(lines), length(roots), length(lines)
print("cplantbox", version("cplantbox"))
for name, (roots, lines, simulated_cm, written_cm) in found.items():
    print(f"{name}: {roots} roots of {simulated_cm:.1f} cm simulated, {lines} roots of {written_cm:.1f} cm in the file")
assert found["Plant"][0] > 100 and found["Plant"][1] == 0, "Plant.write writes roots now"
assert found["RootSystem"][3] < 0.6 * found["RootSystem"][2], "RootSystem.write writes the first points of laterals now"
PYTHON
