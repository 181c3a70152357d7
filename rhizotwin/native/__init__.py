"""What Dr.Jit takes from the system and a bare Linux lacks: one function of libatomic."""

import ctypes
import platform
import sys
from pathlib import Path

ATOMIC = Path(__file__).with_name("atomic_x86_64.so")
"""Built from the C file beside it, whose first lines give the command."""


def ensure_libatomic() -> bool:
    """Load a stand-in for libatomic.so.1 where the system has none.

    A library that was loaded under the same internal name is taken by all that are loaded after it.

    Returns
    -------
    bool
        Whether the stand-in was loaded.
    """
    if sys.platform != "linux" or platform.machine().lower() not in ("x86_64", "amd64"):
        return False
    try:
        ctypes.CDLL("libatomic.so.1")
    except OSError:
        ctypes.CDLL(str(ATOMIC), mode=ctypes.RTLD_GLOBAL)
        return True
    return False
