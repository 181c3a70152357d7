"""The release, rehearsed: packages are built, installed from a folder and run from an empty one."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = PROJECT["version"]
MOST_WHEEL_BYTES = 4_000_000


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_one_version_everywhere() -> None:
    released = re.search(rf"^## {re.escape(VERSION)} \((\d{{4}}-\d\d-\d\d)\)$", text("CHANGELOG.md"), re.MULTILINE)
    assert released is not None
    assert re.search(r"^version: (.*)$", text("CITATION.cff"), re.MULTILINE)[1] == VERSION  # type: ignore[index]
    assert f'date-released: "{released[1]}"' in text("CITATION.cff")
    assert f'version: "{VERSION}"' in text("packaging/conda/recipe.yaml")


def test_conda_recipe_has_every_dependency_with_its_bound() -> None:
    called = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
    recipe = text("packaging/conda/recipe.yaml")
    needs = dict(re.fullmatch(r"([A-Za-z0-9-]+)(\S*).*", need.partition(";")[0]).groups() for need in PROJECT["dependencies"])  # type: ignore[union-attr,misc]
    assert needs.pop("karellen-llvm-core")
    assert "- libllvm19" in recipe
    assert [name for name, bound in needs.items() if f"    - {called.get(name, name)} {bound}\n" not in recipe] == []


@pytest.mark.parametrize("name", ["packaging/Dockerfile", "packaging/rhizotwin.def"])
def test_containers_install_the_lock_of_users(name: str) -> None:
    assert set(re.findall(r"requirements[a-z-]*\.lock", text(name))) == {"requirements.lock"}


def test_licences() -> None:
    spec = importlib.util.spec_from_file_location("licences", ROOT / "packaging" / "licences.py")
    licences = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
    spec.loader.exec_module(licences)  # type: ignore[union-attr]
    found = {one.metadata["Name"].lower() for one in licences.needed()}
    assert {"rhizotwin", "mitsuba", "pandas", "viser", "certifi"} <= found  # the last through others
    assert not {"pytest", "imagecodecs", "rawpy", "statsmodels"} & found
    assert all(licences.refused("a", licence) for licence in ("GPL-3.0-or-later", "MIT AND AGPL-3.0-only", licences.UNKNOWN))
    assert not licences.refused("a", "BSD-3-Clause AND 0BSD AND MIT AND Zlib AND CC0-1.0")
    bad = {one.metadata["Name"] for one in licences.needed() if licences.refused(one.metadata["Name"].lower(), licences.licence(one))}
    assert bad == set()
    listed = set(re.findall(r"^\| ([A-Za-z0-9_.-]+) \|", text("docs/licences.md"), re.MULTILINE))
    assert {name.lower().replace("_", "-") for name in listed} >= {name.replace("_", "-") for name in found}


def build(source: Path, kind: str, goal: Path) -> Path:
    code = f"from setuptools import build_meta; import sys; print(build_meta.build_{kind}(sys.argv[1]))"
    command = [sys.executable, "-W", "ignore", "-c", code, goal]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return goal / done.stdout.splitlines()[-1]


@pytest.mark.slow
def test_build_a_release_and_install_it(tmp_path: Path) -> None:
    dist, source = tmp_path / "dist", tmp_path / "source"
    dist.mkdir()
    source.mkdir()
    for name in ("LICENSE", "README.md", "pyproject.toml"):
        shutil.copy(ROOT / name, source)
    unwanted = shutil.ignore_patterns("__pycache__")
    for name in ("recon", "rig", "scenes", "sim", "rhizotwin"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=unwanted)
    sdist = build(source, "sdist", dist)
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    # the wheel is made of the sdist alone, as pip and conda-forge do
    wheel = build(tmp_path / "unpacked" / f"rhizotwin-{VERSION}", "wheel", dist)
    assert wheel.name == f"rhizotwin-{VERSION}-py3-none-any.whl"
    assert wheel.stat().st_size < MOST_WHEEL_BYTES
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    tops = ("rhizotwin", *(f"rhizotwin/{name}" for name in ("recon", "rig", "scenes", "sim")))
    files = [path for top in tops for path in (ROOT / top).rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    ours = {path.relative_to(ROOT).as_posix() for path in files}
    assert {name for name in names if ".dist-info/" not in name} == ours

    installed = tmp_path / "installed"
    pip = [sys.executable, "-m", "pip", "--isolated", "--disable-pip-version-check", "install", "--quiet"]
    options = ["--no-deps", "--no-cache-dir", "--no-compile", "--only-binary", ":all:", "--no-index", "--find-links", dist]
    command = [*pip, *options, "--target", installed, f"rhizotwin=={VERSION}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    anywhere = tmp_path / "anywhere"
    anywhere.mkdir()
    code = "import rhizotwin, sys; from rhizotwin.__main__ import main; print(rhizotwin.__file__); sys.exit(main(['scenes']))"
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=anywhere, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].startswith(str(installed))
    assert "printed_8ml" in done.stdout
