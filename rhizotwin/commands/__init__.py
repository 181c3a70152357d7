"""The commands, one module each. The module holds a typed function whose numpydoc docstring is the ``--help`` text.

To add a command, write its function in a module of the same name and add a line to `COMMANDS`. A module is imported
only when its command is typed. Slow imports (Mitsuba, SciPy, ...) belong inside the function, so that ``--help`` is
fast.
"""

COMMANDS = {
    "scenes": "List the example scenes and error profiles, or write a scene or its specimen to a file.",
    "simulate": "Render the pictures of a scene, with the ground truth.",
    "reconstruct": "Reconstruct root shape and volume from the pictures of a dataset.",
    "import": "Create a dataset from a folder of pictures.",
    "batch": "Reconstruct many scans, locally or on a cluster.",
    "batch simulate": "Render many scenes: plants, days, treatments, profiles and seeds.",
    "catalogue": "List the plants, scans, results and masses of an experiment in one file.",
    "catalogue add": "Add datasets, results and tables of masses to a catalogue.",
    "catalogue plant": "Add a plant to a catalogue, with the number of its canister.",
    "catalogue list": "List a table of a catalogue, or the number of entries of each.",
    "catalogue query": "Run a SELECT statement on a catalogue.",
    "catalogue check": "Compare a catalogue with its files: missing, changed, damaged and unlisted ones.",
    "catalogue report": "Write a page with the plants, the scans that were missed, and control charts of the rig.",
    "catalogue export": "Write every table of a catalogue as CSV.",
    "catalogue rebuild": "Create a catalogue again from its datasets, results and tables of masses.",
    "score": "Compare a result with ground truth, a known part, a measured volume or other pictures.",
    "phantom": "Compare a scan of copper wires with their known diameters.",
    "view": "Inspect and correct results in a browser.",
    "report": "Write the report of a result again, or one report for several results.",
    "edit": "Apply saved corrections to a result without a browser.",
    "traits": "Print the traits of results, or write them to a table.",
    "growth": "Track plants and single roots over time, and compare treatments.",
    "biomass": "Predict the mass of living plants from harvested ones.",
    "biomass tables": "Write the tables of masses and volumes of Kliman's thesis (2022).",
    "biomass fit": "Fit a model of mass on volume and other traits, with errors in both variables.",
    "biomass predict": "Predict the mass of plants that were not weighed, with 90 % intervals.",
    "export": "Convert a result to other file formats, or publish datasets and results.",
    "plan": "Compare capture plans (views, rings, picture sizes) in simulation.",
    "bench": "Run reconstruction methods on standard benchmarks and compare them.",
    "bench list": "List the benchmarks and their cases.",
    "bench make": "Render a benchmark and verify its pictures.",
    "bench run": "Run a method on each case of a benchmark, score its output, and measure time and memory.",
    "bench score": "Score output that a method wrote on another computer, such as a cluster.",
    "bench table": "Show the results of several methods side by side.",
    "bench gate": "Compare results with a baseline; the exit code is 1 if a number got worse.",
    "demo": "Simulate, reconstruct and score a small printed root (a few minutes).",
    "markers": "Write the marker strip of a scene for printing at true scale.",
    "parts": "Write the mechanical parts of a rig for 3D printing.",
    "calibrate": "Calibrate the camera: print a calibration board and fit the lens to pictures of it.",
    "calibrate board": "Write the calibration board for printing at true scale.",
    "calibrate camera": "Fit the lens to pictures of the calibration board.",
    "calibrate transfer": "Measure the response curve of the camera from an exposure series.",
    "calibrate simulate": "Render pictures of the calibration board with the camera of a scene.",
    "scan": "Scan a plant: take the pictures of a capture plan on a rig, or on the emulated rig.",
    "timelapse": "Scan the same plants again and again by a schedule.",
    "timelapse example": "Write a complete, commented experiment file as a starting point.",
    "timelapse run": "Run a time-lapse experiment until its schedule is done.",
    "timelapse status": "Print which scans of an experiment are made, missed and still to be made.",
    "console": "Serve the laboratory console: control the rig, scan and reconstruct in a browser.",
    "twin": "Run the emulated rig on ports that any serial program can open.",
    "rig": "Check and move the devices of a rig, and write a rig file.",
    "rig check": "Check every device of a rig.",
    "rig jog": "Move the devices of a rig by typed commands.",
    "rig align": "Align the camera with the canister: level, upright, and aimed at the axis.",
    "rig example": "Write a complete, commented rig file as a starting point.",
    "camera": "Serve the camera of this computer to another computer.",
}
"""Name and one-line help of each command. ``a b`` is function ``b`` of module ``a``; ``a`` is function ``a``
of module ``a``."""

GROUPS = frozenset(name.partition(" ")[0] for name in COMMANDS if " " in name)
"""Commands with subcommands. Their help is the docstring of their module."""

ALONE = frozenset({"batch"})
"""Groups that are also commands themselves. Their help is the docstring of their function."""


def place(name: str) -> str:
    """Return the location of a command's function as ``module:function``.

    Python keywords get an underscore: ``import`` becomes ``import_``.
    """
    module, _, function = name.partition(" ")
    module, function = (f"{word}_" if word in ("import", "list") else word for word in (module, function or module))
    return f"{__name__}.{module}:{function}"
