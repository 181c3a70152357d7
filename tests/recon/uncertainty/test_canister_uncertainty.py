"""What another canister does to a volume, against the slow way: every point looked for where it agrees best with all views."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from rhizotwin.recon.hull import carve
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.uncertainty import canister_uncertainty
from rhizotwin.recon.uncertainty.canister_uncertainty import CUBE_MM, misread
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from tests.recon.hull.exact_pictures import views_of

SCENE = Scene(plan=CapturePlan(rings=(Ring(views=5),)))
BELIEVED, VIEWS = Optics.from_scene(SCENE), views_of(SCENE)
OTHERS = {
    "wall": replace(BELIEVED, inner_radius_mm=BELIEVED.inner_radius_mm - 0.3),
    "radius": replace(BELIEVED, outer_radius_mm=BELIEVED.outer_radius_mm + 0.7, inner_radius_mm=BELIEVED.inner_radius_mm + 0.7),
}
POINT_MM = np.array([[22.0, -14.0, -70.0]])


def found(true: Optics, point: np.ndarray) -> np.ndarray:
    """Return where a point is found that is seen through another canister."""
    seen = [(view, cameras.project_inner(view, true, point[None])) for view in VIEWS]

    def off(at: np.ndarray) -> np.ndarray:
        return np.concatenate([(cameras.project_inner(view, BELIEVED, at[None]) - px).ravel() for view, px in seen])

    return np.asarray(least_squares(off, point, x_scale=0.01).x)


@pytest.mark.parametrize("name", OTHERS)
def test_misread_is_what_looking_for_every_point_gives(name: str) -> None:
    true = OTHERS[name]
    ends = [[found(true, POINT_MM[0] + 0.5 * side * CUBE_MM * np.eye(3)[axis]) for side in (-1.0, 1.0)] for axis in range(3)]
    slowly = float(np.linalg.det(np.array([(high - low) / CUBE_MM for low, high in ends])) - 1.0)
    quickly = misread(VIEWS, BELIEVED, true, POINT_MM)
    assert quickly == pytest.approx(slowly, rel=1e-3)
    assert abs(slowly) > 1e-5
    assert misread(VIEWS, BELIEVED, BELIEVED, POINT_MM) == pytest.approx(0.0, abs=1e-7)


def test_few_views_give_what_all_give_in_the_order_of_carving(monkeypatch: pytest.MonkeyPatch) -> None:
    many = views_of(Scene(plan=CapturePlan(rings=(Ring(views=40),))))
    carved = [many[k] for k in carve.spread(len(many))]
    few = misread(carved, BELIEVED, OTHERS["radius"], POINT_MM)
    monkeypatch.setattr(canister_uncertainty, "VIEWS", len(many))
    assert few == pytest.approx(misread(carved, BELIEVED, OTHERS["radius"], POINT_MM), rel=0.05)
