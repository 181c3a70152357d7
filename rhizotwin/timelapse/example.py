"""Example of an experiment file."""

_EXPERIMENT = """\
# A time-lapse experiment: six radishes in two treatments, one scan a day for ten days.
# It runs as it is on the emulated rig: rhizotwin timelapse run THIS_FILE
name = "low nitrogen"

# Rig file ("rhizotwin rig example" writes an example), or "twin" for the emulated rig in virtual time.
rig = "twin"
# Scene of the rig (canister, marker strip, calibrated camera and capture plan): a name from "rhizotwin scenes", or a file.
scene = "radish_day15a"

# Catalogue file, and folders of datasets and results, relative to the folder of this file.
catalogue = "low_nitrogen.rhizotwin"
scans = "scans"
results = "results"

[schedule]
start = "2026-12-01T09:00"  # local time
every_h = 24
rounds = 10
# tips_every_min = 30       # short scans between the rounds for the motion of root tips; tips_views = 8 pictures each
late_h = 12                 # maximum delay of a scan; a later scan is recorded as missed
change = "person"           # who or what puts the canisters on the turntable: person or carousel
tries = 3                   # number of attempts if a scan fails
pause_min = 5               # pause between two attempts

[twin]                      # options of the emulated rig
profile = "bench"
fidelity = "sketch"         # sketch: pictures without the plant; render: pictures that can be reconstructed (minutes per scan)

[reconstruction]
run = true

# Canister N has the marker strip number N printed by "rhizotwin markers SCENE --labels 6 -o strips.pdf"."""
_PLANT = """
[[plants]]
name = "P{number}"
canister = {number}
species = "Raphanus sativus"
treatment = "{treatment}"
sown = "2026-11-26"
"""
_LOW_N = """\
growth = 0.85               # growth factor of the simulated plant on the emulated rig

[plants.solution]
recipe = "kliman_2022"
factors = {{ N = 0.5 }}
"""
EXAMPLE = "".join(
    [
        _EXPERIMENT,
        *(_PLANT.format(number=number, treatment="control") for number in (1, 2, 3)),
        *((_PLANT + _LOW_N).format(number=number, treatment="low N") for number in (4, 5, 6)),
    ]
)
"""Text of an experiment file with six plants in two treatments."""
