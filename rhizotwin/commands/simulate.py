"""`rhizotwin simulate`."""

from dataclasses import dataclass
from typing import Literal

from cyclopts import Parameter

from rhizotwin import command_steps, front_door
from rhizotwin.arguments import Device, OutputDataset, Progress, Samples, SceneChanges, SceneName, Seed, SubjectOptions


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Rendering:
    """How pictures are made."""

    fidelity: Literal["backlit", "path"] = "backlit"
    """backlit: fast, without noise of its own; path: full path tracing with all reflections, slower."""
    samples: Samples | None = None
    """Light paths a pixel: more is slower and smoother; default: as the fidelity needs."""


def simulate(
    scene: SceneName,
    /,
    *,
    output: OutputDataset,
    changes: SceneChanges = SceneChanges(),
    subject: SubjectOptions = SubjectOptions(),
    rendering: Rendering = Rendering(),
    seed: Seed = 0,
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Render a scene to a dataset, with its truth.

    Render every view of a scene's capture plan to a dataset folder: pictures as the camera would take them, and the
    truth beside them. Stopped half-way, the same command goes on where it stopped.

    Parameters
    ----------
    scene : str
        A name from 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        Folder to make the dataset in: new, empty, or left by the same command when it was stopped.
    changes : SceneChanges
        What is changed in the scene.
    subject : SubjectOptions
        Whose roots they are.
    rendering : Rendering
        How the pictures are made.
    seed : int
        Random seed for all simulated errors and noise: 0, 1, 2, ...
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin simulate printed_8ml -o my_dataset
    rhizotwin simulate printed_8ml -o my_dataset --profile bench --views 24 --image-wh 400x300
    rhizotwin simulate sphere_20mm -o my_dataset --specimen my_root.stl
    rhizotwin simulate sphere_20mm -o my_dataset --specimen my_roots.rsml --specimen-unit cm --specimen-diameter-mm 0.5
    """
    changed = subject.told(front_door.load_scene(scene, **vars(changes)))
    command_steps.print_marker_warnings(changed)
    command_steps.start_engine(device, quiet=progress.quiet)
    with progress.bar(render=1.0) as bar:
        dataset = front_door.simulate(changed, output, profile=changes.profile, seed=seed, **vars(rendering), monitor=bar)
    from rhizotwin.scenes.truth import load_truth

    for note in load_truth(output).drawn["notes"]:
        print(f"note: {note}")
    print(f"{len(dataset.frames)} pictures in {output / 'images'}, the truth in {output / 'truth'}")
    print(f"next: rhizotwin reconstruct {output} -o my_result")
