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
    between,
    list_of,
    option,
    options,
    read_image_wh,
    read_views,
    whole,
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
"""Height in mm, and tilt in degrees and distance in mm where they are given, of each ring."""


def read_height(text: str) -> tuple[float, float | None, float | None]:
    """Read a camera's height in mm, with its tilt in degrees behind a colon and its distance in mm behind an @."""
    place, at, distance_mm = text.partition("@")
    height_mm, colon, tilt_deg = place.partition(":")
    return (
        between(height_mm, HEIGHT_LIMITS_MM, "mm"),
        between(tilt_deg, TILT_LIMITS_DEG, "degrees") if colon else None,
        between(distance_mm, DISTANCE_LIMITS_MM, "mm") if at else None,
    )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Grid:
    """What is varied: every combination is tried."""

    views: Annotated[tuple[int, ...], option(list_of(read_views), "N,N,...")] = (20, 40, 41)
    """Views in a ring to try."""
    heights: Annotated[tuple[Rings, ...], options(list_of(read_height), "=MM[:DEG][@MM],...")] = ()
    """Heights of the camera over the canister's rim, one a ring, with the tilt below the horizon behind a colon \
(else it looks where the scene's first ring looks) and the distance from the axis behind an @; once for each set of \
rings to try; default: the scene's first ring, and it with a second one 52 mm higher."""
    image_wh: Annotated[tuple[tuple[int, int], ...] | None, option(list_of(read_image_wh), "WxH,WxH,...")] = None
    """Picture sizes to try; default: the scene's."""


def plan(
    scene: SceneName,
    /,
    *,
    output: OutputFolder,
    grid: Grid = Grid(),
    profile: Profile = "bench",
    seeds: Annotated[int, option(lambda text: whole(text, 1, MAX_SEEDS, f"give 1 to {MAX_SEEDS}"), "N")] = 1,
    within: Annotated[float, option(lambda text: between(text, PERCENT_LIMITS, "%"), "PERCENT")] = 5.0,
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Try capture plans on the twin before building or scanning.

    What a lab asks before it builds: how many views, odd or even, how many rings at which heights, how many pixels?
    Simulate, reconstruct and score a scene with every combination of the given numbers of views, camera heights and
    picture sizes, and say what each reaches: a table, plan.csv, plan.json and a figure, plan.png, and the cheapest plan
    that is good enough. A stopped run is taken up by the same command, and one with more views or heights adds to it.
    On two cores a run takes one to two minutes for 40 pictures of 800x600 of a small plant, and up to five for a large
    one: begin with few views and small pictures.

    Parameters
    ----------
    scene : str
        A scene file (TOML) or a name from 'rhizotwin scenes'.
    output : Path
        Folder for the table, the figure and the scores: new, or of an earlier plan.
    grid : Grid
        What is varied.
    profile : str
        What the rig gets wrong: clean, bench, harsh or a file.
    seeds : int
        Runs of each plan with other errors.
    within : float
        Name the cheapest plan whose volume stays within this.
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    a first look in a few minutes:
      rhizotwin plan radish_day05a -o my_plan --views 10,20 --image-wh 400x300 --profile clean
    odd or even, one ring or two (the second 10 mm above the rim, tilted 8 degrees down, or 200 mm from the axis):
      rhizotwin plan radish_day15a -o my_plan --views 40,41 --heights=-42 --heights=-42,10:8 --heights=-42,-14:0@200
    which heights, to stay within 3 % of the volume:
      rhizotwin plan printed_8ml -o my_plan --views 41 --heights=-42 --heights=-100,-42 --heights=-42,10 --within 3
    how many pixels, for a rig of your own with three draws of its errors:
      rhizotwin plan my_scene.toml -o my_plan --views 40 --image-wh 800x600,1600x1200 --profile bench --seeds 3
    """
    from rhizotwin import planning

    changed = change_scene(files.load_scene(scene), profile=profile)
    variants = _variants(grid, changed)
    command_steps.start_engine(device, quiet=progress.quiet)
    with progress.bar(**planning.shares(variants, seeds)) as bar:
        rows = planning.run_plans(changed, variants, output, profile_name=profile, seeds=seeds, say=bar.say, monitor=bar)
    _tell(planning.best(rows, within=within / 100.0), within)
    print(f"picture: {output / 'plan.png'}; numbers: {output / 'plan.csv'}")


def _tell(chosen: "plans.Row | None", within: float) -> None:
    """Print the cheapest plan that stays within so many per cent."""
    if chosen is None:
        print(f"no plan stays within {within:g} % of the volume; try more views, pixels or rings")
    else:
        print(f"cheapest plan within {within:g} %: {chosen.variant.name}, {chosen.pictures} pictures")


def _variants(grid: Grid, scene: Scene) -> "list[plans.Variant]":
    """Return every combination of what is varied."""
    from rhizotwin import planning, plans

    first_mm = scene.plan.rings[0].height_mm
    own = plans.Height(first_mm)
    asked = [tuple(plans.Height(*ring) for ring in rings) for rings in grid.heights]
    found = [
        plans.Variant(heights=rings, views=count, image_wh=size)
        for size in grid.image_wh or (scene.camera.image_wh,)
        for rings in dict.fromkeys(asked or [(own,), (own, plans.Height(first_mm + planning.SECOND_RING_MM))])
        for count in grid.views
    ]
    for variant in found:
        command_steps.print_marker_warnings(variant.of(scene))
    return found
