"""Choose what computes: LLVM on the CPU or CUDA on an NVIDIA GPU, before Mitsuba is first used.

Dr.Jit loads LLVM at run time, and versions 14, 15 and 16 abort the whole process at the first kernel on AVX-512
processors, so the library is chosen here, by version, and never left to Dr.Jit's own search.
"""

import ctypes
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rhizotwin.native import ensure_libatomic
from rhizotwin.scenes.errors import UserError

DEVICES = ("auto", "cpu", "cuda")
MIN_LLVM = 17
APT_LLVM = (19, 22, 21, 20, 18, 17)
"""Versions to install by apt, best first: 19 and 22 were tried longest."""
LLVM_WHEEL = "karellen-llvm-core==19.1.7"
"""The wheel that is a dependency on Linux on x86-64; those of 21 and 23 do not start Dr.Jit 1.5."""
NO_LLVM = "/no-usable-llvm/libLLVM.so"
"""Where Dr.Jit is pointed when there is no usable LLVM, so that it does not find an old one by itself."""

_VARIANTS = {"cpu": "llvm_ad_mono", "cuda": "cuda_ad_mono"}
_FILE_VERSION = re.compile(r"^libLLVM(?:-C)?(?:-(?P<dashed>\d+)[\d.]*)?\.(?:so|dylib)(?:\.(?P<dotted>\d+)[\d.]*)?$")
_FOLDER_VERSION = re.compile(r"^(?:llvm-)?(\d+)(?:\.\d+)*(?:_\d+)?$")


def llvm_version(library: Path) -> int | None:
    """Return the major LLVM version that a library's name, or its link target's, tells; None when neither does.

    Names in use: ``libLLVM.so.19.1`` (Debian and Ubuntu since 18), ``libLLVM-17.so.1`` and ``libLLVM-14.0.6.so.1``
    (before), ``llvm-19/lib/libLLVM.so`` (links), ``Cellar/llvm/19.1.7/lib/libLLVM.dylib`` (Homebrew).
    """
    for path in (library, library.resolve()):
        match = _FILE_VERSION.match(path.name)
        if match and (match["dashed"] or match["dotted"]):
            return int(match["dashed"] or match["dotted"])
    for folder in library.resolve().parents:
        match = _FOLDER_VERSION.match(folder.name)
        if match:
            return int(match[1])
    return None


def usual_folders() -> list[Path]:
    """Return the folders in which package managers put LLVM's shared library.

    The first two are where `LLVM_WHEEL` and conda do.
    """
    machine = {"arm64": "aarch64", "amd64": "x86_64"}.get(platform.machine().lower(), platform.machine().lower())
    folders = [
        Path(sys.prefix) / "lib",
        Path(sys.prefix) / "Library" / "bin",
        Path(os.environ.get("PROGRAMFILES", "C:/Program Files")) / "LLVM" / "bin",
        Path(f"/usr/lib/{machine}-linux-gnu"),
        Path("/usr/lib64"),
        Path("/usr/lib"),
        Path("/usr/local/lib"),
    ]
    folders += [path / "lib" for path in sorted(Path("/usr/lib").glob("llvm-*"))]
    for prefix in (Path("/opt/homebrew/opt"), Path("/usr/local/opt"), Path("/home/linuxbrew/.linuxbrew/opt")):
        folders += [path / "lib" for path in sorted(prefix.glob("llvm*"))]
    return folders


def find_llvm(folders: Iterable[Path]) -> tuple[Path, int] | None:
    """Return the newest LLVM shared library of at least version 17 in the folders, and its version.

    None if there is none.
    """
    found: list[tuple[int, Path]] = []
    for folder in folders:
        for pattern in ("libLLVM.so*", "libLLVM-*.so*", "libLLVM*.dylib", "LLVM-C.dll"):
            for library in folder.glob(pattern):
                version = llvm_version(library) or (_ask_version(library) if library.suffix == ".dll" else None)
                if version is not None and version >= MIN_LLVM and library.is_file():
                    found.append((version, library))
    if not found:
        return None
    version, library = max(found, key=lambda item: (item[0], -len(item[1].name), str(item[1])))
    return library, version


def install_hint() -> str:
    """Return the command that installs a usable LLVM, and what Dr.Jit needs beside it, on this platform."""
    if platform.system() == "Darwin":
        return "brew install llvm"
    if platform.system() == "Windows":
        return "winget install LLVM.LLVM"
    if has_llvm_wheel():
        return f"pip install {LLVM_WHEEL}"
    if shutil.which("apt-get"):
        return f"sudo apt-get update && sudo apt-get install -y {' '.join(apt_packages())}"
    if shutil.which("dnf"):
        return "sudo dnf install llvm-libs"
    if shutil.which("pacman"):
        return "sudo pacman -S llvm-libs"
    return "your package manager's LLVM shared library (libLLVM.so), version 17 or newer"


def has_llvm_wheel() -> bool:
    """Tell whether LLVM comes as a wheel (`LLVM_WHEEL`) to this platform."""
    return platform.system() == "Linux" and platform.machine().lower() in ("x86_64", "amd64")


def apt_packages() -> list[str]:
    """Return what to install by apt.

    The first LLVM of `APT_LLVM` that apt offers (the first of all if it knows none), and libatomic1.
    """
    names = [f"libllvm{version}{suffix}" for version in APT_LLVM for suffix in ("", "t64")]
    offered: list[str] = []
    apt_cache = shutil.which("apt-cache")
    if apt_cache is not None:
        environment = {**os.environ, "LC_ALL": "C"}
        policy = subprocess.run([apt_cache, "policy", *names], capture_output=True, text=True, check=False, env=environment).stdout
        offered = re.findall(r"^(\S+):\n  Installed:.*\n  Candidate: (?!\(none\))", policy, re.MULTILINE)
    return [next((name for name in names if name in offered), names[0]), "libatomic1"]


def choose_llvm(given: str | None, folders: Iterable[Path]) -> tuple[Path, int]:
    """Return the LLVM library to use and its version: the given one if any, otherwise the newest in the folders.

    Raises
    ------
    UserError
        If the given library is missing, too old or not LLVM, or if there is none of at least version 17.
    """
    if given:
        library = Path(given)
        if not library.is_file():
            raise UserError(f"DRJIT_LIBLLVM_PATH={given} is no file; unset it, or point it to libLLVM of version {MIN_LLVM} or newer")
        version = llvm_version(library) or _ask_version(library)
        if version is None or version < MIN_LLVM:
            what = "of an unknown version" if version is None else f"version {version}"
            raise UserError(
                f"DRJIT_LIBLLVM_PATH={given} is LLVM {what}, but at least {MIN_LLVM} is needed (older ones abort the program); "
                f"unset it, or install a newer one with: {install_hint()}"
            )
        return library, version
    found = find_llvm(folders)
    if found is None:
        raise UserError(f"no LLVM shared library of version {MIN_LLVM} or newer was found; install one with: {install_hint()}")
    return found


def _ask_version(library: Path) -> int | None:
    """Return the major version that the library itself reports, None when it cannot be asked.

    LLVM 16 and newer can.
    """
    try:
        get_version = ctypes.CDLL(str(library)).LLVMGetVersion
    except (OSError, AttributeError):
        return None
    numbers = [ctypes.c_uint(0) for _ in range(3)]
    get_version(*(ctypes.byref(number) for number in numbers))
    return numbers[0].value


def start(device: str = "auto") -> str:
    """Choose the engine, tell Mitsuba, and return one sentence that says what was chosen.

    Parameters
    ----------
    device : str
        ``"cpu"`` (LLVM), ``"cuda"`` (an NVIDIA GPU), or ``"auto"``: the GPU if one is usable, otherwise the CPU.

    Raises
    ------
    UserError
        If the device is unknown or cannot be used; the message holds the command that installs what is missing. Also
        where Dr.Jit was imported before, and loaded an LLVM that is too old.
    """
    if device not in DEVICES:
        raise UserError(f"--device {device} is unknown; choose one of {', '.join(DEVICES)}")
    missing: UserError | None = None
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    try:
        library, version = choose_llvm(None if given == NO_LLVM else given, usual_folders())
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    except UserError as error:
        if device == "cpu" or (device == "auto" and not _has_cuda_driver()):
            raise
        missing = error
        os.environ["DRJIT_LIBLLVM_PATH"] = NO_LLVM

    dr, mi = _load()
    if device != "cpu" and dr.has_backend(dr.JitBackend.CUDA):
        mi.set_variant(_VARIANTS["cuda"])
        return "computing on the NVIDIA GPU (CUDA)"
    if device == "cuda":
        raise UserError("--device cuda: no usable NVIDIA GPU or driver was found; use --device cpu, or install NVIDIA's driver")
    if missing is not None:
        raise missing
    try:
        mi.set_variant(_VARIANTS["cpu"])
    except ImportError as error:
        raise UserError(f"{library} (LLVM {version}) could not be loaded; reinstall it with: {install_hint()}") from error
    loaded = dr.detail.llvm_version()
    if loaded is not None and loaded[0] < MIN_LLVM:
        raise UserError(
            f"Dr.Jit was imported before rhizotwin could choose LLVM, and loaded version {loaded[0]}, which aborts on some processors; "
            f"import rhizotwin and call rhizotwin.engine.start() first, or set DRJIT_LIBLLVM_PATH={library}"
        )
    return f"computing on the CPU with LLVM {version} ({library})"


def ensure(device: str = "auto") -> str | None:
    """Start the engine, unless it runs already and nothing else is asked for.

    Returns
    -------
    str or None
        The sentence of `start`; None where the engine ran already.

    Raises
    ------
    UserError
        As `start`.
    """
    mitsuba = sys.modules.get("mitsuba")
    running = None if mitsuba is None else mitsuba.variant()
    if running is not None and (device == "auto" or _VARIANTS.get(device) == running):
        return None
    return start(device)


def most_threads(count: int) -> None:
    """Let the engine, which was started, use no more processors than this: others work beside it."""
    import drjit

    drjit.set_thread_count(count)


def choose_on_first_use() -> None:
    """Let Mitsuba start the engine when a type of a variant is used first, where it would fail as no variant is set."""
    import mitsuba

    fail: Callable[[str], Any] = mitsuba.__dict__["__getattr__"]

    def first_use(name: str) -> Any:
        if mitsuba.variant() is not None or name.startswith("__"):
            return fail(name)
        start()
        return getattr(mitsuba, name)

    mitsuba.__getattr__ = first_use


def _load() -> tuple[Any, Any]:
    """Import Dr.Jit and Mitsuba; a system library that they lack is the user's to install."""
    ensure_libatomic()
    try:
        import drjit
        import mitsuba
    except (ImportError, NameError) as error:  # Dr.Jit stumbles over its own failed import with a NameError
        reason = error.__context__ if isinstance(error, NameError) and error.__context__ is not None else error
        raise UserError(f"Dr.Jit cannot be loaded ({reason}); install what is missing with: {install_hint()}") from error
    return drjit, mitsuba


def _has_cuda_driver() -> bool:
    """Tell whether NVIDIA's driver library can be loaded."""
    for name in ("libcuda.so.1", "libcuda.so"):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False
