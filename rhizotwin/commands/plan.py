"""Command `rhizotwin plan`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin.scenes import files
from rhizotwin.scenes.model import Scene
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import (
    MAX_SEEDS,
    Computing,
    OutputFolder,
    Profile,
    SceneChanges,
    SceneName,
    list_of,
    option,
    options,
    read_image_wh,
    read_integer,
    read_number,
    read_views,
)
from rhizotwin.steps.scene_changes import change_scene

if TYPE_CHECKING:
    from rhizotwin.planning import plans

HEIGHT_LIMITS_MM = (-2000.0, 2000.0)
TILT_LIMITS_DEG = (-89.0, 89.0)
DISTANCE_LIMITS_MM = (20.0, 10000.0)
PERCENT_LIMITS = (0.01, 1000.0)
Rings = tuple[tuple[float, float | None, float | None], ...]
"""Camera position of each ring: height in mm, tilt in degrees and distance in mm. Tilt and distance are None if they
were not given."""


def read_height(text: str) -> tuple[float, float | None, float | None]:
    """Convert a camera position ``MM[:DEG][@MM]`` to height in mm, tilt in degrees and distance in mm."""
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
    """Options for the parameters to compare, of which all combinations are simulated."""

    views: Annotated[tuple[int, ...], option(list_of(read_views), "N,N,...")] = (20, 40, 41)
    """Numbers of views per ring, separated by commas."""
    heights: Annotated[tuple[Rings, ...], options(list_of(read_height), "HEIGHTS")] = ()
    """Camera heights above the rim of the canister in mm, one for each ring, separated by commas, with an equals \
sign, such as '--heights=-42,10'. A height may be followed by a colon and the downward tilt in degrees (default: \
aimed at the same point as the first ring of the scene), and by @ and the distance from the turntable axis in mm, \
such as 10:8@200. Repeat the option for each set of rings to compare. Default: the first ring of the scene, with \
and without a second ring 52 mm above it."""
    image_wh: Annotated[tuple[tuple[int, int], ...] | None, option(list_of(read_image_wh), "WxH,WxH,...")] = None
    """Picture sizes in pixels, separated by commas, such as 400x300,800x600; default: as in the scene."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SimulatedErrors:
    """Options for the simulated errors of rig and pictures."""

    profile: Profile = "bench"
    """Simulated imperfections of rig and pictures: clean (none), bench (well-built rig), camera (bench with an \
ordinary camera), harsh (badly adjusted rig), real (first scan of a living plant), or a TOML file."""
    seeds: Annotated[int, option(lambda text: read_integer(text, 1, MAX_SEEDS, f"give 1 to {MAX_SEEDS}"), "N")] = 1
    """Number of runs per plan, with different random errors."""


def plan(
    scene: SceneName,
    /,
    *,
    output: OutputFolder,
    grid: Grid = Grid(),
    errors: SimulatedErrors = SimulatedErrors(),
    within: Annotated[float, option(lambda text: read_number(text, PERCENT_LIMITS, "%"), "PERCENT")] = 5.0,
    computing: Computing = Computing(),
) -> None:
    """Determine by simulation how many pictures and camera heights a scan needs.

    A scan consists of rings: turns of the turntable with the camera at a fixed height. A scene is simulated,
    reconstructed and scored for all combinations of the given numbers of views per ring, camera heights and picture
    sizes. The errors are written as a table (plan.csv, plan.json) and a figure (plan.png), and the plan with the
    fewest pixels that meets the error limit is printed. To continue after an interruption, or to add views or
    heights, run the command again. On two cores, a run with 40 pictures of 800x600 pixels takes one to five minutes.

    Parameters
    ----------
    scene : str
        Scene, which describes canister, plant and rig: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        Folder for the table, the figure and the scores: new, or the output of an earlier run.
    grid : Grid
        Parameters to compare.
    errors : SimulatedErrors
        Simulated errors of rig and pictures.
    within : float
        Maximum volume error of the recommended plan in per cent.
    computing : Computing
        Device of the computation, and progress output.

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
    from rhizotwin.planning import comparison

    changed = change_scene(files.load_scene(scene), SceneChanges(profile=errors.profile))
    variants = _variants(grid, changed)
    command_steps.start_engine(computing.device, quiet=computing.quiet)
    with computing.bar(**comparison.shares(variants, errors.seeds)) as bar:
        rows = comparison.run_plans(changed, variants, output, profile_name=errors.profile, seeds=errors.seeds, bar=bar)
    _print_recommended(comparison.best(rows, within=within / 100.0), within)
    print(f"figure: {output / 'plan.png'}; table: {output / 'plan.csv'}")


def _print_recommended(chosen: "plans.Row | None", within: float) -> None:
    """Print the recommended plan.

    If no plan has a volume error of at most ``within`` per cent, a message is printed instead.
    """
    if chosen is None:
        print(f"no plan has a volume error of at most {within:g} %; try more views, larger pictures or more rings")
    else:
        print(f"plan with the fewest pixels and a volume error of at most {within:g} %: {chosen.variant.name}, {chosen.pictures} pictures")


def _variants(grid: Grid, scene: Scene) -> "list[plans.Variant]":
    """Return a capture plan for each combination of the parameters to compare."""
    from rhizotwin.planning import comparison, plans

    first_mm = scene.plan.rings[0].height_mm
    own = plans.Height(first_mm)
    given = [tuple(plans.Height(*ring) for ring in rings) for rings in grid.heights]
    found = [
        plans.Variant(heights=rings, views=count, image_wh=size)
        for size in grid.image_wh or (scene.camera.image_wh,)
        for rings in dict.fromkeys(given or [(own,), (own, plans.Height(first_mm + comparison.SECOND_RING_MM))])
        for count in grid.views
    ]
    for variant in found:
        command_steps.print_marker_warnings(variant.of(scene))
    return found
