"""The commands: a module each, with a plain typed function of its name whose numpydoc docstring is its ``--help``.

To add one, write the function in a module of its name and add a line to `COMMANDS`. The module is loaded only when its
command is typed; what takes time to load (Mitsuba, SciPy, ...) is imported inside the function, so that ``--help``
stays quick.
"""

COMMANDS = {
    "scenes": "List the scenes and profiles that come with the program, write a copy of one, or its specimen to be printed.",
    "simulate": "Render a scene to a dataset, with its truth.",
    "reconstruct": "Find the root's shape and volume in a dataset's pictures.",
    "import": "Make a dataset of a folder of pictures taken elsewhere.",
    "batch": "Reconstruct many scans, here or on a cluster.",
    "batch simulate": "Render many scenes: plants, days, treatments, profiles and seeds.",
    "catalogue": "List the plants, scans, results and masses of an experiment in one file.",
    "catalogue add": "Add datasets, results and tables of masses to a catalogue.",
    "catalogue plant": "Add a plant to a catalogue, with the number of its canister.",
    "catalogue list": "List a table of a catalogue, or the number of entries of each.",
    "catalogue query": "Run a SELECT statement on a catalogue.",
    "catalogue check": "Compare a catalogue with its files: missing, changed and damaged ones, and those that are not listed.",
    "catalogue report": "Write a page with the plants, the scans that were missed, and control charts of the rig.",
    "catalogue export": "Write every table of a catalogue as CSV.",
    "catalogue rebuild": "Create a catalogue again from its datasets, results and tables of masses.",
    "score": "Compare a result with a simulated dataset's truth, a scanned part, a measured volume, or unseen pictures.",
    "phantom": "Compare a scan of copper wires with their known diameters.",
    "view": "Look at results in a browser, and correct them.",
    "report": "Write the page of a result again, or one page for many results.",
    "edit": "Apply saved corrections to a result, without a browser.",
    "traits": "Print the traits of results, or write them to a table for spreadsheets.",
    "growth": "Follow plants and their roots over days, and compare treatments.",
    "biomass": "Predict the mass of living plants from harvested ones.",
    "biomass tables": "Write the thesis's tables of masses and volumes.",
    "biomass fit": "Fit masses to volumes and other traits, with errors on both sides.",
    "biomass predict": "Predict the mass of plants that were not weighed, with 90 % intervals.",
    "export": "Write a result in the files of other programs, or publish datasets and results.",
    "plan": "Try capture plans on the twin before building or scanning.",
    "bench": "Run any method on named benchmarks, and compare methods.",
    "bench list": "List the benchmarks and their cases.",
    "bench make": "Render a benchmark, and check that its pictures are those of every other machine.",
    "bench run": "Run a method on each case of a benchmark, score what it writes, and measure time and memory.",
    "bench score": "Score what a method wrote elsewhere, such as on a cluster.",
    "bench table": "Lay results of several methods side by side.",
    "bench gate": "Compare results with a baseline; the exit code is 1 where a number got worse.",
    "demo": "Take all three steps on a small printed root: a few minutes.",
    "markers": "Write the marker strip of a scene for the printer, at true scale.",
    "parts": "Write the parts of a scene's rig for a 3D printer.",
    "calibrate": "Print a calibration board, and find the camera's lens from pictures of it.",
    "calibrate board": "Write the calibration board for the printer, at true scale.",
    "calibrate camera": "Fit the lens to pictures of the calibration board.",
    "calibrate transfer": "Measure the camera's curve from light to numbers, from a series of exposures.",
    "calibrate simulate": "Render pictures of the calibration board with a scene's camera.",
    "scan": "Take the pictures of a plan on a rig, or on its emulated twin.",
    "timelapse": "Scan the same plants again and again by a schedule.",
    "timelapse example": "Write an experiment file with comments, to be changed.",
    "timelapse run": "Run a time-lapse experiment until its schedule is done.",
    "timelapse status": "Print which scans of an experiment are made, missed and still to be made.",
    "console": "Serve the laboratory console: control the rig, scan and reconstruct in a browser.",
    "twin": "Run the emulated rig alone, on ports that any serial program can open.",
    "rig": "Look at every device, move them by hand, write a rig file.",
    "rig check": "Look at every device: one line each, what is well or what is wrong.",
    "rig jog": "Move every device by typed lines.",
    "rig align": "Turn the camera to face the canister: level, upright, and through its axis.",
    "rig example": "Write a complete rig file with comments, to be changed.",
    "camera": "Serve this computer's camera to another one.",
}
"""Each command and the first line of its help. ``a b`` is the function ``b`` of the module ``a``; ``a`` alone is ``a``
of ``a``."""

GROUPS = frozenset(name.partition(" ")[0] for name in COMMANDS if " " in name)
"""Commands that hold others; their help is their module's docstring."""

ALONE = frozenset({"batch"})
"""Those of them that are commands by themselves too; their help is their function's docstring."""


def place(name: str) -> str:
    """Return where a command's function is, as ``module:function``; a word of Python's own gets an underscore.

    So ``import`` is ``import_``.
    """
    module, _, function = name.partition(" ")
    module, function = (f"{word}_" if word in ("import", "list") else word for word in (module, function or module))
    return f"{__name__}.{module}:{function}"
