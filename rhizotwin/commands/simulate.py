"""Command `rhizotwin simulate`."""

from dataclasses import dataclass
from typing import Literal

from cyclopts import Parameter

from rhizotwin.scenes.formatting import count
from rhizotwin.steps import command_steps, front_door
from rhizotwin.steps.arguments import Computing, OutputDataset, Samples, SceneChanges, SceneName, Seed, SubjectOptions


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Rendering:
    """Options for the rendering and its random errors."""

    fidelity: Literal["backlit", "path"] = "backlit"
    """Rendering method: backlit (fast, without sampling noise) or path (path tracing with all reflections, slower)."""
    samples: Samples | None = None
    """Number of light paths per pixel; more paths reduce the sampling noise and take longer; default: depends on the \
rendering method."""
    seed: Seed = 0
    """Random seed for all simulated errors and noise: 0, 1, 2, ..."""


def simulate(
    scene: SceneName,
    /,
    *,
    output: OutputDataset,
    changes: SceneChanges = SceneChanges(),
    subject: SubjectOptions = SubjectOptions(),
    rendering: Rendering = Rendering(),
    computing: Computing = Computing(),
) -> None:
    """Render the pictures of a scene, and store the true roots with them.

    A scene describes canister, plant, rig and camera positions. The pictures that the camera would take are written to
    the subfolder images of the output folder, and the true roots (ground truth) to the subfolder truth. After an
    interruption, run the same command again to continue.

    Parameters
    ----------
    scene : str
        Scene: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        Folder for the dataset: new, empty, or with an interrupted run of the same command.
    changes : SceneChanges
        Changes to the scene.
    subject : SubjectOptions
        Plant in the canister.
    rendering : Rendering
        Options for the rendering and its random errors.
    computing : Computing
        Device of the computation, and progress output.

    Examples
    --------
    rhizotwin simulate printed_8ml -o my_dataset
    rhizotwin simulate printed_8ml -o my_dataset --profile bench --views 24 --image-wh 400x300
    rhizotwin simulate sphere_20mm -o my_dataset --specimen my_root.stl
    rhizotwin simulate sphere_20mm -o my_dataset --specimen my_roots.rsml --specimen-unit cm --specimen-diameter-mm 0.5
    """
    changed = subject.apply_to(front_door.load_scene(scene, **vars(changes)))
    command_steps.print_marker_warnings(changed)
    command_steps.start_engine(computing.device, quiet=computing.quiet)
    with computing.bar(render=1.0) as bar:
        dataset = front_door.simulate(changed, output, profile=changes.profile, **vars(rendering), monitor=bar)
    from rhizotwin.scenes.truth import load_truth

    for note in load_truth(output).drawn["notes"]:
        print(f"note: {note}")
    print(f"wrote {count(len(dataset.frames), 'picture')} to {output / 'images'} and the ground truth to {output / 'truth'}")
    print(f"next: rhizotwin reconstruct {output} -o my_result")
