"""Run `rhizotwin` commands without what Windows lacks: modules, functions and signals that only POSIX has.

    python tests/packaging/as_windows.py 'scenes' 'simulate sphere_20mm -o dataset'

Libraries are loaded first, as they choose by the platform. `msvcrt.locking` is played with the locks of POSIX. What
this cannot show: separators of paths, files that are open and thus not to be renamed, and the libraries themselves.
"""

import _thread
import errno
import fcntl
import importlib
import os
import signal
import sys
import threading
import types

LIBRARIES = (
    *("cv2", "cyclopts", "drjit", "manifold3d", "matplotlib.backends.backend_agg", "matplotlib.figure", "mitsuba"),
    *("multiprocessing.connection", "nrrd", "numpy"),
    *("pandas", "PIL.Image", "scipy.ndimage", "scipy.optimize", "scipy.sparse.csgraph", "scipy.spatial", "scipy.stats"),
    *("serial.tools.list_ports", "simplejpeg"),
    *("skimage.filters", "skimage.measure", "skimage.morphology", "tempfile", "tifffile", "tqdm", "trimesh", "viser", "webbrowser"),
)
MODULES = ("curses", "fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
FUNCTIONS = (
    *("O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "fork", "getuid", "geteuid", "killpg"),
    *("mkfifo", "openpty", "pread", "pwrite", "sched_getaffinity", "sysconf"),
)
SIGNALS = ("SIGALRM", "SIGHUP", "SIGKILL", "SIGPIPE", "alarm", "setitimer")


def locking(descriptor: int, _mode: int, _count: int) -> None:
    """Lock an open file as a whole, without waiting, as msvcrt does with bytes of it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise OSError(errno.EACCES, "Permission denied") from error


def hide_posix() -> None:
    """Remove from Python what Windows lacks."""
    for name in LIBRARIES:
        importlib.import_module(name)
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    for name in FUNCTIONS:
        if hasattr(os, name):
            delattr(os, name)
    for name in SIGNALS:
        if hasattr(signal, name):
            delattr(signal, name)
    played = types.ModuleType("msvcrt")
    played.locking, played.LK_NBLCK = locking, 2  # type: ignore[attr-defined]
    sys.modules["msvcrt"] = played
    # this library chooses by the platform at every call
    own = types.ModuleType("sys")
    own.__dict__.update(sys.__dict__)
    vars(importlib.import_module("threadpoolctl"))["sys"] = own
    sys.platform = "win32"


def main(commands: list[str]) -> int:
    """Run commands one after another; the exit code is that of the first that fails."""
    hide_posix()
    from rhizotwin.commands import cli
    from rhizotwin.scenes import memory

    # the functions of kernel32 are not here: sizes that any computer has
    memory.total_mib = memory.available_mib = lambda: 4096.0
    memory.peak_mib = lambda: 0.0
    for command in commands:
        if command.startswith("view"):  # it ends by Ctrl-C alone
            threading.Timer(4.0, _thread.interrupt_main).start()
        code = cli.main(command.split())
        if command.startswith("view") and code == cli.EXIT_STOPPED:
            code = 0
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
