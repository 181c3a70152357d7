"""Which LLVM is taken: new enough, never one of those that abort the process, and a clear word when there is none."""

import os
from pathlib import Path

import pytest

from rhizotwin import engine
from rhizotwin.scenes.errors import UserError


@pytest.mark.parametrize(
    ("file", "version"),
    [
        ("libLLVM.so.19.1", 19),
        ("libLLVM-17.so.1", 17),
        ("libLLVM-14.0.6.so.1", 14),
        ("libLLVM-14.so", 14),
        ("libLLVM.so", None),
        ("libLLVM.dylib", None),
        ("libLLVMSomething.so.19", None),
        ("libclang-cpp.so.19", None),
        ("llvm-19/lib/libLLVM.so", 19),
        ("Cellar/llvm/19.1.7/lib/libLLVM.so", 19),
        ("Cellar/llvm@19/19.1.7_1/lib/libLLVM.so", 19),
    ],
)
def test_version_is_read_from_the_names_of_file_and_folder(tmp_path: Path, file: str, version: int | None) -> None:
    library = tmp_path / file
    library.parent.mkdir(parents=True, exist_ok=True)
    library.touch()
    assert engine.llvm_version(library) == version


def test_version_is_read_through_links(tmp_path: Path) -> None:
    (tmp_path / "libLLVM.so.20.1").touch()
    link = tmp_path / "libLLVM.so"
    link.symlink_to("libLLVM.so.20.1")
    assert engine.llvm_version(link) == 20


def make_libraries(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return folder


def test_newest_library_of_all_folders_is_taken_and_never_an_old_one(tmp_path: Path) -> None:
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


def test_hint_names_packages_of_a_usable_version() -> None:
    packages = engine.apt_packages()
    assert "libatomic1" in packages
    assert int(packages[0].removeprefix("libllvm").removesuffix("t64")) >= engine.MIN_LLVM


@pytest.mark.parametrize(
    ("system", "machine", "hint"),
    [
        ("Linux", "x86_64", f"pip install {engine.LLVM_WHEEL}"),
        ("Linux", "aarch64", "libllvm"),
        ("Darwin", "arm64", "brew install llvm"),
        ("Windows", "AMD64", "winget install LLVM.LLVM"),
    ],
)
def test_each_platform_has_a_command_that_brings_llvm(
    system: str, machine: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine.platform, "system", lambda: system)
    monkeypatch.setattr(engine.platform, "machine", lambda: machine)
    monkeypatch.setattr(engine.shutil, "which", lambda name: f"/usr/bin/{name}" if name == "apt-get" else None)
    with pytest.raises(UserError, match="no LLVM shared library of version 17 or newer was found; install one with: ") as caught:
        engine.choose_llvm(None, [tmp_path])
    assert hint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_wheel_is_the_one_that_is_a_dependency() -> None:
    pyproject = (Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    assert f'"{engine.LLVM_WHEEL}; ' in pyproject


def test_windows_library_is_asked_for_its_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_libraries(tmp_path, "LLVM-C.dll")
    monkeypatch.setattr(engine, "_ask_version", lambda _: 19)
    assert engine.find_llvm([folder]) == (folder / "LLVM-C.dll", 19)
    monkeypatch.setattr(engine, "_ask_version", lambda _: 15)
    assert engine.find_llvm([folder]) is None


def test_unknown_device_is_refused() -> None:
    with pytest.raises(UserError, match="--device gpu is unknown"):
        engine.start("gpu")


def test_start_says_what_it_chose() -> None:
    import mitsuba as mi

    assert engine.start(os.environ.get("RHIZOTWIN_TEST_DEVICE", "cpu")).startswith("computing on ")
    assert mi.variant() in ("llvm_ad_mono", "cuda_ad_mono")
    assert float((mi.Float(2.0) * 3.0)[0]) == 6.0


def test_an_old_llvm_that_was_loaded_before_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit

    monkeypatch.setattr(drjit.detail, "llvm_version", lambda: (15, 0, 6))
    with pytest.raises(UserError, match=r"Dr.Jit was imported before .* loaded version 15, .* set DRJIT_LIBLLVM_PATH="):
        engine.start("cpu")
