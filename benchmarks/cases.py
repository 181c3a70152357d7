"""What the accuracy ladder measures: scenes, disturbances, pictures and methods."""

from dataclasses import dataclass, replace
from typing import Literal

from scenes.files import load_profile, load_scene
from scenes.model import Scene

Method = Literal["coverage", "thesis"]

DEFAULT_VOXEL_MM = 0.27
"""The thesis's voxel, and the pipeline's default."""


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """A dataset to render."""

    scene: str
    profile: str = "clean"
    views: int = 40
    """In all, shared evenly between the rings of the scene's plan."""
    image_wh: tuple[int, int] = (800, 600)
    seed: int = 0

    @property
    def name(self) -> str:
        """Short name for keys and messages."""
        return f"{self.scene}/{self.profile}/{self.views}x{self.image_wh[0]}x{self.image_wh[1]}"

    def scene_to_render(self) -> Scene:
        """Return the library's scene with these views, this sensor and the profile's disturbances."""
        scene = load_scene(self.scene)
        share, more = divmod(self.views, len(scene.plan.rings))
        rings = tuple(replace(ring, views=share + (k < more)) for k, ring in enumerate(scene.plan.rings))
        camera = scene.camera if scene.camera.image_wh == self.image_wh else scene.camera.resized(self.image_wh)
        plan = replace(scene.plan, rings=rings)
        return replace(scene, plan=plan, camera=camera, disturbances=load_profile(self.profile))


@dataclass(frozen=True, kw_only=True)
class Case:
    """One reconstruction to score."""

    pictures: Pictures
    voxel_mm: float = DEFAULT_VOXEL_MM
    method: Method = "coverage"

    @property
    def name(self) -> str:
        """Prefix of the keys of this case's metrics."""
        return f"{self.pictures.name}/{self.voxel_mm:g}/{self.method}"


def _both(pictures: Pictures, voxel_mm: float = DEFAULT_VOXEL_MM) -> list[Case]:
    """Return our method and the thesis's on the same pictures."""
    return [Case(pictures=pictures, voxel_mm=voxel_mm), Case(pictures=pictures, voxel_mm=voxel_mm, method="thesis")]


def ladder(*, quick: bool) -> list[Case]:
    """Return the cases of the full table, or of the quick one that runs with every change."""
    if quick:
        small = (400, 300)
        sphere, printed, bench = (
            Pictures(scene="sphere_20mm", views=24, image_wh=small),
            Pictures(scene="printed_8ml", image_wh=small),
            Pictures(scene="printed_8ml", profile="bench", image_wh=small),
        )
        return [Case(pictures=sphere), *_both(printed), Case(pictures=bench)]
    printed, bench = Pictures(scene="printed_8ml"), Pictures(scene="printed_8ml", profile="bench")
    cases = [Case(pictures=Pictures(scene="sphere_20mm")), *_both(printed), *_both(bench)]
    cases += [Case(pictures=printed, voxel_mm=0.135)]
    for plant in "abc":
        cases += _both(Pictures(scene=f"radish_day15{plant}"))
    return [*cases, *_both(Pictures(scene="fallen_plant"))]


TARGETS: dict[str, tuple[float, str]] = {
    "projection/max_px": (1e-3, "1e-3 px"),
    "projection/lost": (0.0, "none"),
    "projection/visibility_disagreement": (0.0, "none"),
    "projection/kernel_max_px": (1e-3, "1e-3 px"),
    "projection/kernel_seen_wrongly": (0.0, "none"),
    "sphere_20mm/clean/40x800x600/0.27/coverage/volume_error": (0.01, "within 1 %"),
    "printed_8ml/clean/40x800x600/0.27/coverage/volume_error": (0.02, "within 2 %"),
    "printed_8ml/clean/40x800x600/0.27/coverage/extents_error_max": (0.01, "within 1 %"),
    "printed_8ml/bench/40x800x600/0.27/coverage/volume_error": (0.04, "within 4 %"),
    "printed_8ml/clean/40x800x600/0.27/coverage/pose_median_mm": (0.05, "0.05 mm"),
    "printed_8ml/clean/40x800x600/0.27/coverage/pose_median_deg": (0.02, "0.02 deg"),
    "printed_8ml/bench/40x800x600/0.27/coverage/pose_median_mm": (0.3, "0.3 mm"),
    "printed_8ml/bench/40x800x600/0.27/coverage/pose_median_deg": (0.1, "0.1 deg"),
    "rig/inverse/closed_form_error": (1e-9, "1e-9"),
    "rig/inverse/newton_failed": (0.001, "0.1 %"),
    "rig/faults/problems": (0.0, "none"),
    "rig/kills/problems": (0.0, "none"),
    "rig/overhead/per_view": (0.05, "50 ms"),
    "rig/calibrate/clean/focal_error": (0.001, "0.1 %"),
    "rig/calibrate/bench/focal_error": (0.001, "0.1 %"),
    "rig/calibrate/clean/rms": (0.2, "0.2 px"),
    "rig/calibrate/bench/rms": (0.2, "0.2 px"),
    "rig/scan/volume_error": (0.04, "within 4 %"),
    "render/backlit/800x600/per_view": (3.0, "3 s"),
    "render/path/800x600/per_view": (10.0, "10 s"),
    "reconstruct/40x800x600/0.27/wall": (20.0, "20 s"),
    "reconstruct/40x800x600/0.07/wall": (60.0, "60 s"),
    "reconstruct/40x800x600/0.27/peak_memory": (4096.0, "4 GiB"),
    "reconstruct/40x800x600/0.07/peak_memory": (4096.0, "4 GiB"),
}
"""What must be reached, as the largest magnitude, by metric."""
