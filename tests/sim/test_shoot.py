"""The twin's shoot: one closed solid with the leaf area and volume that its description says."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.shoots import Shoot
from rhizotwin.sim import shoot as shoots
from rhizotwin.sim.shoot import ShootSolid, build_shoot


def build(**changes: object) -> ShootSolid:
    solid = build_shoot(Scene(shoot=replace(Shoot(), **changes)))
    assert solid is not None
    return solid


def test_it_is_closed_stands_on_the_pot_and_has_its_seeds_leaves() -> None:
    assert build_shoot(Scene()) is None
    solid = build(seed=3)
    np.testing.assert_array_equal(build(seed=3).vertices, solid.vertices)
    assert build(seed=4).leaf_area_mm2 != solid.leaf_area_mm2
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(solid.volume_mm3, rel=1e-9)
    assert solid.vertices[:, 2].min() == pytest.approx(Scene().net_pot.top_mm + shoots.GAP_MM, abs=0.01)
    assert solid.height_mm == pytest.approx(solid.vertices[:, 2].max() - Scene().net_pot.top_mm)


def test_a_flat_blade_has_its_outline_s_area_times_its_thickness() -> None:
    flat = {"leaves": 1, "size_sd": 0.0, "elevation_sd_deg": 0.0, "droop_deg": 0.0, "fold_deg": 0.0}
    thin, thick = build(**flat, thickness_mm=0.2), build(**flat, thickness_mm=0.4)
    along = (np.arange(100_000) + 0.5) / 100_000
    width = np.maximum(np.sqrt(1.0 - (2.0 * along**0.85 - 1.0) ** 2), shoots.TIP_SHARE)
    assert thin.leaf_area_mm2 == pytest.approx(40.0 * 24.0 * width.mean(), rel=0.01)
    # petiole and stem are the same in both, but for what of them lies in the blade
    assert thick.volume_mm3 - thin.volume_mm3 == pytest.approx(0.2 * thin.leaf_area_mm2, rel=0.02)


def test_leaves_in_the_pot_are_refused() -> None:
    with pytest.raises(UserError, match=r"below the top of the net pot .* Increase shoot\.elevation_deg"):
        build(elevation_deg=-40.0)
