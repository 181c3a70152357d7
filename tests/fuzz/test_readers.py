"""Whatever is in a file, what reads it gives something or says in one sentence what is wrong."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rhizotwin.building.measures import load_measures
from rhizotwin.importer.colmap_model import read_colmap
from rhizotwin.importer.nerfstudio_file import read_cameras
from rhizotwin.rig.rig_file import load_rig
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_scene
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.picture_codec import decode_grey
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.stored import result_files
from rhizotwin.stored.load import load_result
from tests.fuzz.mutate import mutated

CORPUS = Path(__file__).parent / "corpus"
READERS: dict[str, Callable[[Path], object]] = {
    "scene.toml": load_scene,
    "rig.toml": load_rig,
    "measures.toml": load_measures,
    "transforms.json": lambda path: read_cameras(path, Camera()),
    **{
        f"colmap_{kind}/{name}.{kind}": lambda path: read_colmap(path.parent, Camera())
        for kind, name in (("bin", "cameras"), ("bin", "images"), ("txt", "images"))
    },
    "dataset/dataset.json": lambda path: load_dataset(path.parent),
    "result/result.json": lambda path: load_result(path.parent),
    "result/shape.npz": lambda path: result_files.read_leaves(path.parent),
    "result/shape.ply": result_files.read_mesh,
    "result/roots.rsml": read_rsml,
    **{
        name: lambda path: decode_grey(path.read_bytes(), where=path.name)
        for name in ("eight.png", "sixteen.png", "colour.png", "picture.jpg", "deflate.tiff", "lzw.tiff", "bare.tif")
    },
}


@pytest.mark.parametrize("name", READERS)
def test_the_corpus_itself_is_read(name: str, tmp_path: Path) -> None:
    READERS[name](Path(shutil.copytree(CORPUS, tmp_path / "corpus")) / name)


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_files_end_in_a_sentence(name: str, seed: int, tmp_path: Path) -> None:
    path = tmp_path / name
    if path.parent != tmp_path:
        shutil.copytree(CORPUS / path.parent.name, path.parent, dirs_exist_ok=True)
    path.write_bytes(mutated((CORPUS / name).read_bytes(), np.random.default_rng(seed)))
    with suppress(UserError):
        READERS[name](path)
