"""The program: `rhizotwin` and `python -m rhizotwin` begin here.

Until `rhizotwin.cli.main` can say so in a sentence, Ctrl-C ends the program without a word instead of with a traceback.
"""

import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)

from rhizotwin.cli import main  # noqa: E402 - first the signal

if __name__ == "__main__":
    sys.exit(main())
