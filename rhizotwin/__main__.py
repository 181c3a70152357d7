"""The program: `rhizotwin` and `python -m rhizotwin` begin here.

Until `rhizotwin.cli.main` can say so in a sentence, Ctrl-C ends the program without a word instead of with a traceback.
"""

import logging
import os
import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)
# before NumPy is loaded: its matrices here are small, and threads that wait for the next one spin
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if sys.platform == "win32":  # whose pipes and files have a few letters only
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="replace")

from rhizotwin.cli import main  # noqa: E402 - first the signal
from rhizotwin.scenes.formatting import DEBUG_VARIABLE  # noqa: E402

# what libraries have to say to programmers; what a person must know is said in a sentence
if not os.environ.get(DEBUG_VARIABLE):
    logging.captureWarnings(True)  # not a filter, which libraries change when they are loaded
    logging.getLogger("py.warnings").setLevel(logging.CRITICAL)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)

if __name__ == "__main__":
    sys.exit(main())
