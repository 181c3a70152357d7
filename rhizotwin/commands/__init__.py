"""Commands of the program, with one module per command or group of commands.

`cli` is the entry point, `command_line` the parser; `page_options` has the options of printed pages.

A command is a typed function whose numpydoc docstring is the ``--help`` text. To add a command, write its function in a
module of the same name, and add a line to `COMMANDS`. A module is imported only when its command is used. Imports that
are slow (Mitsuba, SciPy, ...) should be inside the function, so that ``--help`` is fast.
"""

COMMANDS = {
    "scenes": "List the scenes and profiles of the library, or write a scene or its specimen to a file.",
    "simulate": "Render the pictures of a scene, and store the true roots with them.",
    "reconstruct": "Reconstruct root shape and volume from the pictures of a dataset.",
    "import": "Create a dataset from a folder of pictures.",
    "batch": "Reconstruct many scans, locally or on a cluster.",
    "batch simulate": "Render many scenes, optionally for several plants, ages and treatments.",
    "catalogue": "Manage the list of an experiment's plants, scans, results and weighed masses in one file.",
    "catalogue add": "Add datasets, results, and tables of masses or of the nutrient solution to a catalogue.",
    "catalogue plant": "Add a plant to a catalogue, with the number of its canister.",
    "catalogue list": "Print a table of a catalogue, or the number of entries in each table.",
    "catalogue query": "Run a read-only SQL query on a catalogue.",
    "catalogue check": "Find files of a catalogue that are missing, changed, damaged or not listed.",
    "catalogue report": "Write a page with the plants, missed scans, and control charts of the rig.",
    "catalogue export": "Write all tables of a catalogue as CSV files.",
    "catalogue rebuild": "Create a lost catalogue again from its datasets, results and tables.",
    "score": "Compute the errors of a result with respect to the true roots or another reference.",
    "verify": "Compare a result with rendered pictures of its own shape, which show whether the result explains the scan.",
    "phantom": "Compare a scan of copper wires with the known diameters of the wires.",
    "view": "Inspect and correct results in a browser.",
    "report": "Write the report of a result again, or one report for several results.",
    "edit": "Apply saved corrections to a result without a browser.",
    "traits": "Print the traits of results, or write them to a table.",
    "growth": "Compute growth curves of plants and individual roots, and compare treatments.",
    "biomass": "Predict the mass of living plants with a model fitted to harvested plants.",
    "biomass tables": "Write the example tables of masses and volumes from Kliman's thesis (2022).",
    "biomass example": "Write the results of eighteen simulated plants, scanned several times, and a table of their masses.",
    "biomass fit": "Fit a model that predicts mass from volume or another trait, with errors in both variables.",
    "biomass predict": "Predict the mass of plants that were not weighed, with 90 % intervals.",
    "export": "Convert a result to other file formats, or publish datasets and results.",
    "plan": "Determine by simulation how many pictures and camera heights a scan needs.",
    "bench": "Run reconstruction methods on standard benchmarks and compare them.",
    "bench list": "List the benchmarks and their cases.",
    "bench make": "Render a benchmark and verify its pictures.",
    "bench run": "Run a method on each case of a benchmark, score its output, and measure time and memory.",
    "bench score": "Score output that a method has written on another computer, such as a cluster.",
    "bench table": "Show the results of several methods in one table.",
    "bench gate": "Compare results with a baseline; the exit code is 1 if a value is worse.",
    "demo": "Simulate, reconstruct and score a small printed root (about two minutes), or show a finished example.",
    "markers": "Write the strip of printed markers around the net pot, for printing at true scale.",
    "parts": "Write the mechanical parts of a rig for 3D printing.",
    "calibrate": "Calibrate the camera: print a calibration board and fit the lens to pictures of it.",
    "calibrate board": "Write the calibration board for printing at true scale.",
    "calibrate camera": "Fit the lens to pictures of the calibration board.",
    "calibrate transfer": "Measure the response curve of the camera from an exposure series.",
    "calibrate simulate": "Render pictures of the calibration board with the camera of a scene.",
    "scan": "Scan a plant with the rig, or with the emulated rig.",
    "timelapse": "Scan the same plants repeatedly according to a schedule.",
    "timelapse example": "Write a complete, commented experiment file as a starting point.",
    "timelapse run": "Run a time-lapse experiment until its schedule is complete.",
    "timelapse status": "Print the numbers of finished, missed and planned scans of an experiment.",
    "timelapse tips": "Measure the motion of root tips in short scans.",
    "console": "Control the rig, scan and reconstruct in a browser.",
    "twin": "Run the emulated rig on ports that any serial program can open.",
    "rig": "Check and move the devices of a rig, and write a rig file.",
    "rig check": "Check each device of a rig.",
    "rig jog": "Move the devices of a rig by typed commands.",
    "rig align": "Align the camera with the canister: level, upright, and aimed at the axis.",
    "rig example": "Write a complete, commented rig file as a starting point.",
    "camera": "Make the camera of this computer available to another computer.",
}
"""Name and one-line help of each command. The command ``a b`` is the function ``b`` in the module ``a``, and the
command ``a`` is the function ``a`` in the module ``a``."""

GROUPS = frozenset(name.partition(" ")[0] for name in COMMANDS if " " in name)
"""Commands that have subcommands. Their help text is the docstring of the module."""

ALONE = frozenset({"batch"})
"""Commands with subcommands that can also be used without a subcommand. Their help text is that of the function."""


def place(name: str) -> str:
    """Return the location of a command's function as ``module:function``.

    An underscore is appended to Python's reserved or built-in names, so that ``import`` becomes ``import_``.
    """
    module, _, function = name.partition(" ")
    module, function = (f"{word}_" if word in ("import", "list") else word for word in (module, function or module))
    return f"{__name__}.{module}:{function}"
