"""Reconstruction of plant roots in round water canisters from pictures, with a digital twin of the imaging rig.

    import rhizotwin as rt

    dataset = rt.simulate("radish_day15b", "my_dataset", profile="bench")
    result = rt.reconstruct(dataset)
    result.volume_mm3, result.interval_mm3, result.trusted
    result.save("my_result")
    rt.plot(result)
    rt.score(result, dataset)

Each name is imported when it is first used. The first function that computes selects the CPU or the GPU.
"""

from functools import cache as _cache
from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

if _TYPE_CHECKING:
    from rhizotwin.api.outputs import export, publish
    from rhizotwin.api.scans import import_pictures, scan
    from rhizotwin.api.studies import batch, benchmark, biomass, growth
    from rhizotwin.recon.settings import Settings
    from rhizotwin.scenes.dataset import Dataset, load_dataset
    from rhizotwin.scenes.errors import UserError
    from rhizotwin.scenes.model import Scene
    from rhizotwin.scenes.monitor import Cancelled, Monitor
    from rhizotwin.scoring.score import Score
    from rhizotwin.steps.arguments import Placing
    from rhizotwin.steps.display import plot, view
    from rhizotwin.steps.front_door import load_result, load_scene, reconstruct, score, score_file, simulate
    from rhizotwin.steps.illustrated import Result
    from rhizotwin.steps.results import edit, traits, write_report
    from rhizotwin.steps.verification import verify

    __version__: str

__all__ = [
    "Cancelled",
    "Dataset",
    "Monitor",
    "Placing",
    "Result",
    "Scene",
    "Score",
    "Settings",
    "UserError",
    "batch",
    "benchmark",
    "biomass",
    "edit",
    "export",
    "growth",
    "import_pictures",
    "load_dataset",
    "load_result",
    "load_scene",
    "plot",
    "publish",
    "reconstruct",
    "scan",
    "score",
    "score_file",
    "simulate",
    "traits",
    "verify",
    "view",
    "write_report",
]

_PLACES = {
    "Cancelled": "scenes.monitor",
    "Dataset": "scenes.dataset",
    "Monitor": "scenes.monitor",
    "Placing": "steps.arguments",
    "Result": "steps.illustrated",
    "Scene": "scenes.model",
    "Score": "scoring.score",
    "Settings": "recon.settings",
    "UserError": "scenes.errors",
    "batch": "api.studies",
    "benchmark": "api.studies",
    "biomass": "api.studies",
    "edit": "steps.results",
    "export": "api.outputs",
    "growth": "api.studies",
    "import_pictures": "api.scans",
    "load_dataset": "scenes.dataset",
    "load_result": "steps.front_door",
    "load_scene": "steps.front_door",
    "plot": "steps.display",
    "publish": "api.outputs",
    "reconstruct": "steps.front_door",
    "scan": "api.scans",
    "score": "steps.front_door",
    "score_file": "steps.front_door",
    "simulate": "steps.front_door",
    "traits": "steps.results",
    "verify": "steps.verification",
    "view": "steps.display",
    "write_report": "steps.results",
}
"""Name of the submodule of ``rhizotwin`` in which each public name is defined. The key is the public name."""


def __getattr__(name: str) -> _Any:
    """Import a public name when it is first used."""
    if name == "__version__":
        from importlib.metadata import version

        return version("rhizotwin")
    if name not in _PLACES:
        raise AttributeError(f"module 'rhizotwin' has no attribute {name!r}")
    return _public(name)


@_cache
def _public(name: str) -> _Any:
    """Return a public name, whose calls are checked."""
    from rhizotwin.steps.python_calls import public

    return public(getattr(_import_module(f"rhizotwin.{_PLACES[name]}"), name))


def __dir__() -> list[str]:
    """Return the public names of the package."""
    return sorted([*__all__, "__version__"])
