"""Which LLVM is taken: new enough, never one of those that abort the process, and a clear word when there is none."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from rhizotwin import engine
from rhizotwin.scenes.errors import UserError


@dataclass(frozen=True)
class Name:
    """A library's file name and the version that it tells."""

    file: str
    version: int | None


NAMES = [
    Name("libLLVM.so.19.1", 19),
    Name("libLLVM.so.18.1", 18),
    Name("libLLVM-17.so.1", 17),
    Name("libLLVM-17.so", 17),
    Name("libLLVM-15.so.1", 15),
    Name("libLLVM-14.0.6.so.1", 14),
    Name("libLLVM-14.so", 14),
    Name("libLLVM.so", None),
    Name("libLLVM.dylib", None),
    Name("libLLVMSomething.so.19", None),
    Name("libclang-cpp.so.19", None),
]


@pytest.mark.parametrize("name", NAMES, ids=lambda name: name.file)
def test_version_is_read_from_the_file_name(tmp_path: Path, name: Name) -> None:
    assert engine.llvm_version(tmp_path / name.file) == name.version


@pytest.mark.parametrize("folder", ["llvm-19/lib", "Cellar/llvm/19.1.7/lib", "Cellar/llvm@19/19.1.7_1/lib"])
def test_version_is_read_from_the_folder_of_a_bare_name(tmp_path: Path, folder: str) -> None:
    library = tmp_path / folder / "libLLVM.so"
    library.parent.mkdir(parents=True)
    library.touch()
    assert engine.llvm_version(library) == 19


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


def test_newest_library_of_all_folders_is_taken(tmp_path: Path) -> None:
    a = make_libraries(tmp_path / "a", "libLLVM-14.so.1", "libLLVM-17.so.1", "libLLVM.so.9.0")
    b = make_libraries(tmp_path / "b", "libLLVM.so.18.1", "libLLVM-15.so")
    assert engine.find_llvm([a, b, tmp_path / "missing"]) == (b / "libLLVM.so.18.1", 18)


def test_old_libraries_are_never_taken(tmp_path: Path) -> None:
    folder = make_libraries(tmp_path, "libLLVM-14.so.1", "libLLVM-15.so", "libLLVM-16.so.1", "libLLVM.so", "libLLVM.so.1")
    assert engine.find_llvm([folder]) is None
    with pytest.raises(UserError, match=r"no LLVM shared library of version 17 or newer .* install"):
        engine.choose_llvm(None, [folder])


def test_given_library_is_respected(tmp_path: Path) -> None:
    folder = make_libraries(tmp_path, "libLLVM.so.19.1", "libLLVM-17.so.1")
    assert engine.choose_llvm(str(folder / "libLLVM-17.so.1"), [folder]) == (folder / "libLLVM-17.so.1", 17)


def test_given_old_library_is_refused_by_version(tmp_path: Path) -> None:
    folder = make_libraries(tmp_path, "libLLVM-15.so.1", "libLLVM.so.19.1")
    with pytest.raises(UserError, match=r"DRJIT_LIBLLVM_PATH=.*libLLVM-15.so.1 is LLVM version 15, but at least 17"):
        engine.choose_llvm(str(folder / "libLLVM-15.so.1"), [folder])


def test_given_library_of_no_known_version_is_refused(tmp_path: Path) -> None:
    library = make_libraries(tmp_path / "odd", "libLLVM.so") / "libLLVM.so"
    with pytest.raises(UserError, match="of an unknown version"):
        engine.choose_llvm(str(library), [])


def test_given_library_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is no file"):
        engine.choose_llvm(str(tmp_path / "libLLVM.so.19.1"), [])


def test_hint_names_packages_of_a_usable_version() -> None:
    packages = engine.apt_packages()
    assert "libatomic1" in packages
    assert int(packages[0].removeprefix("libllvm").removesuffix("t64")) >= engine.MIN_LLVM


def test_unknown_device_is_refused() -> None:
    with pytest.raises(UserError, match="--device gpu is unknown"):
        engine.start("gpu")


def test_start_says_what_it_chose(engine_started: str) -> None:
    import mitsuba as mi

    assert engine_started.startswith("computing on ")
    assert mi.variant() in ("llvm_ad_mono", "cuda_ad_mono")
    assert float((mi.Float(2.0) * 3.0)[0]) == 6.0
