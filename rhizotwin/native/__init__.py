"""Substitute for the system library libatomic.

Dr.Jit requires this library, which is missing on a minimal Linux system.
"""

import ctypes
import platform
import sys
from pathlib import Path

ATOMIC = Path(__file__).with_name("atomic_x86_64.so")
"""Shared library that contains the required function. The first lines of the C file next to it contain the command with
which it was compiled."""


def ensure_libatomic() -> bool:
    """Load the substitute for libatomic.so.1 if the system does not provide this library.

    The substitute has the same internal name, so libraries that are loaded later use it.

    Returns
    -------
    bool
        Whether the substitute was loaded.
    """
    if sys.platform != "linux" or platform.machine().lower() not in ("x86_64", "amd64"):
        return False
    try:
        ctypes.CDLL("libatomic.so.1")
    except OSError:
        ctypes.CDLL(str(ATOMIC), mode=ctypes.RTLD_GLOBAL)
        return True
    return False
