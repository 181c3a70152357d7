"""`rhizotwin plan`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin import command_steps
from rhizotwin.arguments import (
    MAX_SEEDS,
    Device,
    OutputFolder,
    Profile,
    Progress,
    SceneName,
    list_of,
    option,
    options,
    read_image_wh,
    read_integer,
    read_number,
    read_views,
)
from rhizotwin.scene_changes import change_scene
from rhizotwin.scenes import files
from rhizotwin.scenes.model import Scene

if TYPE_CHECKING:
    from rhizotwin import plans

HEIGHT_LIMITS_MM = (-2000.0, 2000.0)
TILT_LIMITS_DEG = (-89.0, 89.0)
DISTANCE_LIMITS_MM = (20.0, 10000.0)
PERCENT_LIMITS = (0.01, 1000.0)
Rings = tuple[tuple[float, float | None, float | None], ...]
"""Height in mm, optional tilt in degrees and optional distance in mm of each ring."""


def read_height(text: str) -> tuple[float, float | None, float | None]:
    """Read a camera height as ``MM[:DEG][@MM]``: height in mm, tilt in degrees, distance in mm."""
    place, at, distance_mm = text.partition("@")
    height_mm, colon, tilt_deg = place.partition(":")
    return (
        read_number(height_mm, HEIGHT_LIMITS_MM, "mm"),
        read_number(tilt_deg, TILT_LIMITS_DEG, "degrees") if colon else None,
        read_number(distance_mm, DISTANCE_LIMITS_MM, "mm") if at else None,
    )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Grid:
    """Varied parameters; every combination is simulated."""

    views: Annotated[tuple[int, ...], option(list_of(read_views), "N,N,...")] = (20, 40, 41)
    """Numbers of views per ring."""
    heights: Annotated[tuple[Rings, ...], options(list_of(read_height), "=MM[:DEG][@MM],...")] = ()
    """Camera heights above the rim of the canister in mm, one per ring, each optionally with the downward tilt in \
degrees after a colon (default: aimed at the same point as the first ring of the scene) and the distance from the \
axis after an @. Repeat the option for each set of rings. Default: the first ring of the scene alone, and with a \
second ring 52 mm higher."""
    image_wh: Annotated[tuple[tuple[int, int], ...] | None, option(list_of(read_image_wh), "WxH,WxH,...")] = None
    """Picture sizes in pixels; default: as in the scene."""


def plan(
    scene: SceneName,
    /,
    *,
    output: OutputFolder,
    grid: Grid = Grid(),
    profile: Profile = "bench",
    seeds: Annotated[int, option(lambda text: read_integer(text, 1, MAX_SEEDS, f"give 1 to {MAX_SEEDS}"), "N")] = 1,
    within: Annotated[float, option(lambda text: read_number(text, PERCENT_LIMITS, "%"), "PERCENT")] = 5.0,
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Compare capture plans (views, rings, picture sizes) in simulation.

    Simulate, reconstruct and score a scene with every combination of the given numbers of views, camera heights and
    picture sizes. The errors are written as a table (plan.csv, plan.json) and a figure (plan.png), and the plan with
    the fewest pictures that meets the error limit is printed. If interrupted, run the same command again to continue; a
    later run with more views or heights adds to the table. On two cores, one run with 40 pictures of 800x600 pixels
    takes one to two minutes for a small plant and up to five for a large one. Start with few views and small pictures.

    Parameters
    ----------
    scene : str
        Name of a scene (listed by 'rhizotwin scenes') or path of a scene file (TOML).
    output : Path
        Folder for the table, the figure and the scores: new, or the output of an earlier run.
    grid : Grid
        Varied parameters.
    profile : str
        Simulated errors of the rig: clean (none), bench (a well-built rig), camera (bench with an ordinary camera),
        harsh (a badly adjusted rig), real (a first scan of a living plant), or a TOML file.
    seeds : int
        Number of runs per plan, each with other random errors.
    within : float
        Error limit of the volume in per cent for the recommended plan.
    device : str
        Compute device: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available).
    progress : Progress
        Progress output.

    Examples
    --------
    quick test in a few minutes:
      rhizotwin plan radish_day05a -o my_plan --views 10,20 --image-wh 400x300 --profile clean
    odd and even numbers of views, one and two rings (second ring with a tilt of 8 degrees, or 200 mm from the axis):
      rhizotwin plan radish_day15a -o my_plan --views 40,41 --heights=-42 --heights=-42,10:8 --heights=-42,-14:0@200
    camera heights for a volume error within 3 %:
      rhizotwin plan printed_8ml -o my_plan --views 41 --heights=-42 --heights=-100,-42 --heights=-42,10 --within 3
    picture sizes for your own scene, with three sets of random errors:
      rhizotwin plan my_scene.toml -o my_plan --views 40 --image-wh 800x600,1600x1200 --profile bench --seeds 3
    """
    from rhizotwin import planning

    changed = change_scene(files.load_scene(scene), profile=profile)
    variants = _variants(grid, changed)
    command_steps.start_engine(device, quiet=progress.quiet)
    with progress.bar(**planning.shares(variants, seeds)) as bar:
        rows = planning.run_plans(changed, variants, output, profile_name=profile, seeds=seeds, say=bar.say, monitor=bar)
    _print_recommended(planning.best(rows, within=within / 100.0), within)
    print(f"figure: {output / 'plan.png'}; table: {output / 'plan.csv'}")


def _print_recommended(chosen: "plans.Row | None", within: float) -> None:
    """Print the plan with the fewest pictures within the error limit in per cent."""
    if chosen is None:
        print(f"no plan has a volume error within {within:g} %; try more views, larger pictures or more rings")
    else:
        print(f"plan with the fewest pictures within {within:g} %: {chosen.variant.name}, {chosen.pictures} pictures")


def _variants(grid: Grid, scene: Scene) -> "list[plans.Variant]":
    """Return every combination of the varied parameters."""
    from rhizotwin import planning, plans

    first_mm = scene.plan.rings[0].height_mm
    own = plans.Height(first_mm)
    given = [tuple(plans.Height(*ring) for ring in rings) for rings in grid.heights]
    found = [
        plans.Variant(heights=rings, views=count, image_wh=size)
        for size in grid.image_wh or (scene.camera.image_wh,)
        for rings in dict.fromkeys(given or [(own,), (own, plans.Height(first_mm + planning.SECOND_RING_MM))])
        for count in grid.views
    ]
    for variant in found:
        command_steps.print_marker_warnings(variant.of(scene))
    return found
