"""Entry point of the program: `rhizotwin` and `python -m rhizotwin`.

Spawned worker processes import this module too, so it prepares the process when it is imported. Until
`rhizotwin.cli.main` handles Ctrl-C, it ends the program silently instead of with a traceback.
"""

import logging
import os
import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)
# before NumPy is loaded: the matrices here are small, and waiting threads would use up processors
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if sys.platform == "win32":  # its pipes and files can encode few characters only
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="replace")

from rhizotwin.cli import main  # noqa: E402 - after the signal and the environment are set
from rhizotwin.scenes.formatting import DEBUG_VARIABLE  # noqa: E402 - as above

# warnings of libraries are for programmers; users get messages
if not os.environ.get(DEBUG_VARIABLE):
    logging.captureWarnings(True)  # not a filter, which libraries change when they are loaded
    logging.getLogger("py.warnings").setLevel(logging.CRITICAL)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)

if __name__ == "__main__":
    sys.exit(main())
