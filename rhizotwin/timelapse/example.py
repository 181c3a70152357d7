"""The example of an experiment file."""

_EXPERIMENT = """\
# A time-lapse experiment: six radishes in two treatments, one scan a day for ten days.
# It runs as it is on the emulated rig: rhizotwin timelapse run THIS_FILE
name = "low nitrogen"

# Rig file ("rhizotwin rig example" writes one), or "twin": the emulated rig, in virtual time.
rig = "twin"
# Scene of the rig: canister, strip, calibrated camera and plan; a name from "rhizotwin scenes", or a file.
scene = "radish_day15a"

# Catalogue, datasets and results, relative to this file.
catalogue = "low_nitrogen.rhizotwin"
scans = "scans"
results = "results"

[schedule]
start = "2026-12-01T09:00"  # local time
every_h = 24
rounds = 10
late_h = 12                 # a scan that has not begun by then is recorded as missed
change = "person"           # who puts the canisters on the table: person, or carousel
tries = 3                   # a scan that fails is tried so often ...
pause_min = 5               # ... with so many minutes between

[twin]                      # only for rig = "twin"
profile = "bench"
fidelity = "sketch"         # render: pictures that can be reconstructed, which takes minutes for each scan

[reconstruction]
run = true

# The strip on the pot of canister N is strip N of "rhizotwin markers SCENE --labels 6 -o strips.pdf"."""
_PLANT = """
[[plants]]
name = "P{number}"
canister = {number}
species = "Raphanus sativus"
treatment = "{treatment}"
sown = "2026-11-26"
"""
_LOW_N = """\
growth = 0.85               # on the emulated rig

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
"""Text of the example."""
