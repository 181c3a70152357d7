"""A digital twin of a hydroponic root-imaging rig, and the reconstruction of roots from its pictures.

    import rhizotwin as rt

    scene = rt.load_scene("radish_day15b")
    dataset = rt.simulate(scene, "my_dataset", profile="bench")
    result = rt.reconstruct(dataset)
    result.volume_mm3, result.interval_mm3, result.trusted
    result.save("my_result")
    print(rt.score(result, dataset).table())

Importing it loads nothing: each name is loaded when it is used, and what computes is chosen by the first call that
needs it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rhizotwin.arguments import Placing
    from rhizotwin.front_door import load_result, load_scene, reconstruct, score, score_file, simulate
    from rhizotwin.recon.results.result import Result
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scenes.dataset import Dataset, load_dataset
    from rhizotwin.scenes.errors import UserError
    from rhizotwin.scenes.model import Scene
    from rhizotwin.scenes.monitor import Cancelled, Monitor

    __version__: str

__all__ = [
    "Cancelled",
    "Dataset",
    "Monitor",
    "Placing",
    "Result",
    "Scene",
    "Settings",
    "UserError",
    "load_dataset",
    "load_result",
    "load_scene",
    "reconstruct",
    "score",
    "score_file",
    "simulate",
]

_PLACES = {
    "Cancelled": "scenes.monitor",
    "Dataset": "scenes.dataset",
    "Monitor": "scenes.monitor",
    "Placing": "arguments",
    "Result": "recon.results.result",
    "Scene": "scenes.model",
    "Settings": "recon.settings",
    "UserError": "scenes.errors",
    "load_dataset": "scenes.dataset",
    "load_result": "front_door",
    "load_scene": "front_door",
    "reconstruct": "front_door",
    "score": "front_door",
    "score_file": "front_door",
    "simulate": "front_door",
}
"""The module of each name."""


def __getattr__(name: str) -> Any:
    """Load a name when it is used first."""
    if name == "__version__":
        from importlib.metadata import version

        return version("rhizotwin")
    if name not in _PLACES:
        raise AttributeError(f"module 'rhizotwin' has no attribute {name!r}")
    return getattr(import_module(f"rhizotwin.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    """Return what completion offers."""
    return sorted([*globals(), *__all__, "__version__"])
