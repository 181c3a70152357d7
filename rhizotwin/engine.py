"""Selection of the compute engine before Mitsuba is first used: LLVM on the CPU, or CUDA on an NVIDIA GPU.

Dr.Jit loads LLVM at run time. LLVM 14, 15 and 16 abort the process at the first kernel on AVX-512 processors, so this
module selects the library by its version instead of leaving the search to Dr.Jit.
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
from rhizotwin.scenes.errors import UserError, pip_install

DEVICES = ("auto", "cpu", "cuda")
MIN_LLVM = 17
APT_LLVM = (19, 22, 21, 20, 18, 17)
"""Versions of LLVM to install with apt, in order of preference. Versions 19 and 22 have been tested most."""
LLVM_WHEEL = "karellen-llvm-core==19.1.7"
"""Python package that contains LLVM. It is installed as a dependency on Linux on x86-64. Its versions 21 and 23 are not
used, because Dr.Jit 1.5 cannot load them."""
NO_LLVM = "/no-usable-llvm/libLLVM.so"
"""Path passed to Dr.Jit if no usable LLVM is installed. It does not exist, so that Dr.Jit does not load a version that
is too old."""

_VARIANTS = {"cpu": "llvm_ad_mono", "cuda": "cuda_ad_mono"}
_FILE_VERSION = re.compile(r"^libLLVM(?:-C)?(?:-(?P<dashed>\d+)[\d.]*)?\.(?:so|dylib)(?:\.(?P<dotted>\d+)[\d.]*)?$")
_FOLDER_VERSION = re.compile(r"^(?:llvm-)?(\d+)(?:\.\d+)*(?:_\d+)?$")


def llvm_version(library: Path) -> int | None:
    """Parse the major LLVM version from the path of a library or of its link target.

    Supported names are ``libLLVM.so.19.1`` (Debian and Ubuntu since LLVM 18), ``libLLVM-17.so.1`` and
    ``libLLVM-14.0.6.so.1`` (older releases), ``llvm-19/lib/libLLVM.so`` (links) and
    ``Cellar/llvm/19.1.7/lib/libLLVM.dylib`` (Homebrew).

    Returns
    -------
    int or None
        Major version, or None if the path does not include a version.
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
    """Return the folders in which package managers install the shared library of LLVM.

    The first two folders are those of `LLVM_WHEEL` and conda.
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
    """Find the newest LLVM shared library of version 17 or newer in the folders.

    Returns
    -------
    tuple of (Path, int) or None
        Path and major version of the library, or None if no such library was found.
    """
    libraries: list[tuple[int, Path]] = []
    for folder in folders:
        for pattern in ("libLLVM.so*", "libLLVM-*.so*", "libLLVM*.dylib", "LLVM-C.dll"):
            for library in folder.glob(pattern):
                version = llvm_version(library) or (_ask_version(library) if library.suffix == ".dll" else None)
                if version is not None and version >= MIN_LLVM and library.is_file():
                    libraries.append((version, library))
    if not libraries:
        return None
    version, library = max(libraries, key=lambda item: (item[0], -len(item[1].name), str(item[1])))
    return library, version


def install_hint() -> str:
    """Return the command that installs a usable LLVM and the other libraries required by Dr.Jit on this platform."""
    if platform.system() == "Darwin":
        return "brew install llvm"
    if platform.system() == "Windows":
        return "winget install LLVM.LLVM"
    if has_llvm_wheel():
        return pip_install(LLVM_WHEEL)
    if shutil.which("apt-get"):
        return f"sudo apt-get update && sudo apt-get install -y {' '.join(apt_packages())}"
    if shutil.which("dnf"):
        return "sudo dnf install llvm-libs"
    if shutil.which("pacman"):
        return "sudo pacman -S llvm-libs"
    return "your package manager's LLVM shared library (libLLVM.so), version 17 or newer"


def has_llvm_wheel() -> bool:
    """Return whether the Python package `LLVM_WHEEL` supports this platform."""
    return platform.system() == "Linux" and platform.machine().lower() in ("x86_64", "amd64")


def apt_packages() -> list[str]:
    """Return the names of the apt packages to install.

    The list contains the first version of `APT_LLVM` that apt offers, or the first entry if apt offers none, and
    libatomic1.
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
    """Select the LLVM library.

    It is the given library, or the newest library in the folders if none is given.

    Returns
    -------
    tuple of (Path, int)
        Path and major version of the library.

    Raises
    ------
    UserError
        If the given library is missing, too old or not LLVM, or if the folders contain no LLVM of version 17 or newer.
    """
    if given:
        library = Path(given)
        if not library.is_file():
            raise UserError(
                f"the file in the environment variable DRJIT_LIBLLVM_PATH={given} does not exist; "
                f"unset the variable, or set it to libLLVM of version {MIN_LLVM} or newer"
            )
        version = llvm_version(library) or _ask_version(library)
        if version is None or version < MIN_LLVM:
            what = "of an unknown version" if version is None else f"version {version}"
            raise UserError(
                f"DRJIT_LIBLLVM_PATH={given} is LLVM {what}, but version {MIN_LLVM} or newer is needed (older versions abort the program); "
                f"unset the variable, or install a newer LLVM with: {install_hint()}"
            )
        return library, version
    newest = find_llvm(folders)
    if newest is None:
        raise UserError(f"no LLVM shared library of version {MIN_LLVM} or newer was found; install one with: {install_hint()}")
    return newest


def _ask_version(library: Path) -> int | None:
    """Load an LLVM library, and return the major version that the library itself reports.

    Returns
    -------
    int or None
        Major version, or None if the library cannot be loaded or is LLVM older than 16, which has no such function.
    """
    try:
        get_version = ctypes.CDLL(str(library)).LLVMGetVersion
    except (OSError, AttributeError):
        return None
    numbers = [ctypes.c_uint(0) for _ in range(3)]
    get_version(*(ctypes.byref(number) for number in numbers))
    return numbers[0].value


def start(device: str = "auto") -> str:
    """Select the compute engine and set the corresponding Mitsuba variant.

    Parameters
    ----------
    device : str
        ``"cpu"`` (LLVM), ``"cuda"`` (NVIDIA GPU), or ``"auto"`` (the GPU if it is usable, otherwise the CPU).

    Returns
    -------
    str
        Sentence that states the selected device, for the user.

    Raises
    ------
    UserError
        If the device is unknown or cannot be used, with the command that installs missing software; or if Dr.Jit was
        imported before and has loaded an LLVM that is too old.
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
    """Start the compute engine if it is not running on the requested device.

    Returns
    -------
    str or None
        Sentence returned by `start`, or None if the engine was already running.

    Raises
    ------
    UserError
        If the device is unknown or cannot be used, see `start`.
    """
    mitsuba = sys.modules.get("mitsuba")
    running = None if mitsuba is None else mitsuba.variant()
    if running is not None and (device == "auto" or _VARIANTS.get(device) == running):
        return None
    return start(device)


def most_threads(count: int) -> None:
    """Limit the number of processors that the running compute engine uses."""
    import drjit

    drjit.set_thread_count(count)


def choose_on_first_use() -> None:
    """Change Mitsuba so that it starts the compute engine when it is first used.

    Without this change, the first use would fail, because no variant is set.
    """
    import mitsuba

    fail: Callable[[str], Any] = mitsuba.__dict__["__getattr__"]

    def first_use(name: str) -> Any:
        if mitsuba.variant() is not None or name.startswith("__"):
            return fail(name)
        start()
        return getattr(mitsuba, name)

    mitsuba.__getattr__ = first_use


def _load() -> tuple[Any, Any]:
    """Import and return Dr.Jit and Mitsuba.

    Raises
    ------
    UserError
        If a required system library is missing, with the command that installs it.
    """
    ensure_libatomic()
    try:
        import drjit
        import mitsuba
    except (ImportError, NameError) as error:  # Dr.Jit raises NameError after its own import has failed
        reason = error.__context__ if isinstance(error, NameError) and error.__context__ is not None else error
        raise UserError(f"Dr.Jit cannot be loaded ({reason}); install the missing library with: {install_hint()}") from error
    return drjit, mitsuba


def _has_cuda_driver() -> bool:
    """Return whether NVIDIA's driver library can be loaded."""
    for name in ("libcuda.so.1", "libcuda.so"):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False
