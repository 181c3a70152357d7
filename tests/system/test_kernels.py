"""Kernels that are compiled for one scan serve the next, whatever its size."""

from collections.abc import Iterator
from pathlib import Path

import drjit as dr
import pytest

import rhizotwin as rt

pytestmark = pytest.mark.nightly


@pytest.fixture
def history() -> Iterator[None]:
    was = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    yield
    dr.set_flag(dr.JitFlag.KernelHistory, was)


def compiled(folder: Path, *, scene: str, views: int, image_wh: tuple[int, int]) -> int:
    """Return how many kernels the reconstruction of a scan needs that this process has not used before."""
    rt.simulate(rt.load_scene(scene, views=views, image_wh=image_wh), folder, profile="clean")
    dr.kernel_history_clear()
    rt.reconstruct(folder)
    return sum(not kernel["cache_hit"] for kernel in dr.kernel_history())


@pytest.mark.usefixtures("history")
def test_another_size_compiles_hardly_any_kernel(tmp_path: Path) -> None:
    assert compiled(tmp_path / "first", scene="printed_8ml", views=20, image_wh=(400, 300)) > 50
    assert compiled(tmp_path / "second", scene="radish_day05a", views=14, image_wh=(360, 270)) <= 5
