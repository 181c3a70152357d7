"""Total and available memory of the computer, and peak memory of this process."""

import ctypes
import os
import sys
from pathlib import Path

MIB = 2.0**20


def total_mib() -> float:
    """Return the total memory of the computer, MiB."""
    if sys.platform == "win32":
        return _windows_memory().total_bytes / MIB
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / MIB


def available_mib() -> float:
    """Return the available memory, MiB.

    It is limited by the system and by the control group of this process.
    """
    if sys.platform == "win32":
        return _windows_memory().free_bytes / MIB
    free = total_mib()
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            free = float(line.split()[1]) / 1024.0
    limit, used = _lines("/sys/fs/cgroup/memory.max"), _lines("/sys/fs/cgroup/memory.current")
    if limit and used and limit[0].isdecimal():
        free = min(free, (float(limit[0]) - float(used[0])) / MIB)
    return free


def peak_mib() -> float:
    """Return the peak resident memory of this process, MiB, or 0 if Windows does not report it."""
    if sys.platform == "win32":
        return _windows_peak_bytes() / MIB
    import resource

    unit = MIB if sys.platform == "darwin" else 1024.0  # getrusage(2): bytes on macOS, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


class _MemoryStatus(ctypes.Structure):
    """Structure MEMORYSTATUSEX of the Windows API (sysinfoapi.h)."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("load_percent", ctypes.c_uint32),
        ("total_bytes", ctypes.c_uint64),
        ("free_bytes", ctypes.c_uint64),
        ("others", ctypes.c_uint64 * 5),
    )


class _ProcessMemory(ctypes.Structure):
    """Structure PROCESS_MEMORY_COUNTERS of the Windows API (psapi.h)."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("page_faults", ctypes.c_uint32),
        ("peak_bytes", ctypes.c_size_t),
        ("others", ctypes.c_size_t * 7),
    )


def _windows_memory() -> _MemoryStatus:
    found = _MemoryStatus(size=ctypes.sizeof(_MemoryStatus))
    _kernel32().GlobalMemoryStatusEx(ctypes.byref(found))
    return found


def _windows_peak_bytes() -> int:
    found = _ProcessMemory(size=ctypes.sizeof(_ProcessMemory))
    kernel = _kernel32()
    kernel.GetCurrentProcess.restype = ctypes.c_void_p
    kernel.K32GetProcessMemoryInfo.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32)
    kernel.K32GetProcessMemoryInfo(kernel.GetCurrentProcess(), ctypes.byref(found), found.size)
    return int(found.peak_bytes)


def _kernel32() -> ctypes.CDLL:
    return ctypes.CDLL("kernel32")


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
