"""`python -m rhizotwin` is the `rhizotwin` command."""

import sys

from rhizotwin.cli import main

sys.exit(main())
