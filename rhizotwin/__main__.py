"""Entry point of the program: `rhizotwin` and `python -m rhizotwin`.

Spawned worker processes also import this module, so the process is configured at import. Until
`rhizotwin.commands.cli.main` installs its signal handler, Ctrl-C ends the program without a traceback.
"""

import logging
import os
import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)
# must be set before NumPy is loaded: the matrices are small, and idle BLAS threads would occupy the processors
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if sys.platform == "win32":  # the encoding of pipes and files has few characters
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="replace")

from rhizotwin.commands.cli import main  # noqa: E402 - after the signal and the environment are set
from rhizotwin.scenes.formatting import DEBUG_VARIABLE  # noqa: E402 - as above

# warnings of libraries are for programmers; users get messages
if not os.environ.get(DEBUG_VARIABLE):
    logging.captureWarnings(True)  # instead of a warnings filter, which libraries change when they are loaded
    logging.getLogger("py.warnings").setLevel(logging.CRITICAL)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)

if __name__ == "__main__":
    sys.exit(main())
