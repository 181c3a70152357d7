"""Which LLVM is taken: new enough, never one that aborts the process, a clear word when there is none; and the stand-in for libatomic."""

import ctypes
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from rhizotwin import engine, native
from rhizotwin.scenes.errors import UserError

VERSIONS = {
    "libLLVM.so.19.1": 19,
    "libLLVM-17.so.1": 17,
    "libLLVM-14.0.6.so.1": 14,
    "libLLVM.so": None,
    "libLLVMSomething.so.19": None,
    "llvm-19/lib/libLLVM.so": 19,
    "Cellar/llvm@19/19.1.7_1/lib/libLLVM.so": 19,
}


def test_version_is_read_from_file_folder_and_link(tmp_path: Path) -> None:
    for file in VERSIONS:
        make_libraries((tmp_path / file).parent, Path(file).name)
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "libLLVM.so").symlink_to("../libLLVM.so.19.1")
    assert {file: engine.llvm_version(tmp_path / file) for file in (*VERSIONS, "link/libLLVM.so")} == VERSIONS | {"link/libLLVM.so": 19}


def make_libraries(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return folder


def test_the_newest_library_is_taken_and_never_an_old_one(tmp_path: Path) -> None:
    a = make_libraries(tmp_path / "a", "libLLVM-14.so.1", "libLLVM-17.so.1", "libLLVM.so.9.0")
    b = make_libraries(tmp_path / "b", "libLLVM.so.18.1", "libLLVM-15.so")
    assert engine.find_llvm([a, b, tmp_path / "missing"]) == (b / "libLLVM.so.18.1", 18)
    old = make_libraries(tmp_path / "old", "libLLVM-14.so.1", "libLLVM-15.so", "libLLVM-16.so.1", "libLLVM.so", "libLLVM.so.1")
    assert engine.find_llvm([old]) is None
    with pytest.raises(UserError, match=r"no LLVM shared library of version 17 or newer .* install"):
        engine.choose_llvm(None, [old])


def test_given_library_is_respected_or_refused(tmp_path: Path) -> None:
    folder = make_libraries(tmp_path, "libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM-15.so.1")
    assert engine.choose_llvm(str(folder / "libLLVM-17.so.1"), [folder]) == (folder / "libLLVM-17.so.1", 17)
    with pytest.raises(UserError, match=r"DRJIT_LIBLLVM_PATH=.*libLLVM-15.so.1 is LLVM version 15, but version 17"):
        engine.choose_llvm(str(folder / "libLLVM-15.so.1"), [folder])
    with pytest.raises(UserError, match="of an unknown version"):
        engine.choose_llvm(str(make_libraries(tmp_path / "odd", "libLLVM.so") / "libLLVM.so"), [])
    with pytest.raises(UserError, match="does not exist"):
        engine.choose_llvm(str(tmp_path / "libLLVM.so.20.1"), [])


def test_a_missing_llvm_is_said_with_a_command_that_brings_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine.platform, "system", lambda: "Darwin")
    with pytest.raises(UserError, match="no LLVM shared library of version 17 or newer was found; install one with: brew install llvm"):
        engine.choose_llvm(None, [tmp_path])
    monkeypatch.setattr(engine.platform, "system", lambda: "Linux")
    monkeypatch.setattr(engine.platform, "machine", lambda: "x86_64")
    with pytest.raises(UserError, match=f"pip install {engine.LLVM_WHEEL}"):
        engine.choose_llvm(None, [tmp_path])


def test_windows_library_is_asked_for_its_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_libraries(tmp_path, "LLVM-C.dll")
    monkeypatch.setattr(engine, "_ask_version", lambda _: 19)
    assert engine.find_llvm([folder]) == (folder / "LLVM-C.dll", 19)
    monkeypatch.setattr(engine, "_ask_version", lambda _: 15)
    assert engine.find_llvm([folder]) is None


def test_start_says_what_it_chose() -> None:
    import mitsuba as mi

    assert engine.start(os.environ.get("RHIZOTWIN_TEST_DEVICE", "cpu")).startswith("computing on ")
    assert mi.variant() in ("llvm_ad_mono", "cuda_ad_mono")
    assert float((mi.Float(2.0) * 3.0)[0]) == 6.0
    with pytest.raises(UserError, match="--device gpu is unknown"):
        engine.start("gpu")


def test_an_old_llvm_that_was_loaded_before_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit

    monkeypatch.setattr(drjit.detail, "llvm_version", lambda: (15, 0, 6))
    with pytest.raises(UserError, match=r"Dr.Jit was imported before .* loaded version 15, .* set DRJIT_LIBLLVM_PATH="):
        engine.start("cpu")


ELSEWHERE = sys.platform != "linux" or platform.machine() != "x86_64"
stand_in = pytest.mark.skipif(ELSEWHERE, reason="the stand-in is for Linux on x86-64; elsewhere nothing is loaded")

WITHOUT_LIBATOMIC = """
import ctypes, sys
load = ctypes.CDLL
def without(name, *args, **kwargs):
    if name == "libatomic.so.1":
        raise OSError(name)
    return load(name, *args, **kwargs)
ctypes.CDLL = without
from rhizotwin.native import ensure_libatomic
assert ensure_libatomic()
import drjit
libraries = {line.split()[-1] for line in open("/proc/self/maps") if "atomic" in line}
print(*libraries)
"""


def exchange(held: bytes, expected: bytes, desired: bytes) -> tuple[bool, bytes, bytes]:
    """Return whether the words were exchanged, and what is held and expected afterwards."""
    function = getattr(ctypes.CDLL(str(native.ATOMIC)), "__atomic_compare_exchange_16")
    function.restype = ctypes.c_bool
    room = ctypes.create_string_buffer(48)  # cmpxchg16b wants multiples of 16
    at = -ctypes.addressof(room) % 16
    room[at : at + 16] = held
    other = ctypes.create_string_buffer(expected, 16)
    low, high = (ctypes.c_uint64(int.from_bytes(desired[k : k + 8], "little")) for k in (0, 8))
    done = function(ctypes.c_void_p(ctypes.addressof(room) + at), other, low, high, 5, 5)
    return bool(done), room[at : at + 16], other.raw


@stand_in
def test_the_stand_in_for_libatomic_compares_and_exchanges() -> None:
    a, b, c = bytes(range(16)), bytes(range(16, 32)), bytes(range(32, 48))
    assert exchange(a, a, b) == (True, b, a)
    assert exchange(a, c, b) == (False, a, a)
    nearly = a[:15] + b"\xff"  # both halves count
    assert exchange(a, nearly, b) == (False, a, a)


@stand_in
def test_drjit_takes_the_stand_in_for_libatomic() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_LIBATOMIC], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(native.ATOMIC)]
