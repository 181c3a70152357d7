"""Command `rhizotwin markers`."""

from dataclasses import replace
from typing import Annotated

from rhizotwin.commands.page_options import PageOptions
from rhizotwin.scenes import files
from rhizotwin.scenes.model import Scene
from rhizotwin.steps.arguments import OutputFile, SceneName, option, read_integer, read_length_mm

PAPER_LIMITS_MM = (0.0, 2.0)


def read_paper_mm(text: str) -> float:
    """Convert text to the thickness of paper in mm."""
    return read_length_mm(text, PAPER_LIMITS_MM)


def markers(
    scene: SceneName,
    /,
    *,
    output: OutputFile,
    page: PageOptions = PageOptions(),
    paper_mm: Annotated[float, option(read_paper_mm, "MM")] = 0.1,
    labels: Annotated[int | None, option(lambda text: read_integer(text, 1, 500, "give 1 to 500"), "N")] = None,
) -> None:
    """Write the strip of printed markers around the net pot, for printing at true scale.

    The strip is glued around the net pot, which holds the plant on the canister, and the camera poses are estimated
    from its markers. It is written as PDF or SVG pages with cut marks, glue tabs and a ruler for checking the scale of
    the print. Several SVG pages are numbered: strip-1.svg, strip-2.svg, ...

    Parameters
    ----------
    scene : str
        Scene, which describes net pot and strip: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        File to write, .pdf or .svg; must not exist yet.
    page : PageOptions
        Paper.
    paper_mm : float
        Thickness of the paper in mm. The length of the strip is chosen such that the outer radius of the glued paper is
        net_pot.outer_radius_mm of the scene.
    labels : int, optional
        Write the strips of the canisters 1 to N. Each strip has different markers, by which a scan identifies the
        canister ('rhizotwin timelapse', 'rhizotwin scan --catalogue'). The dictionary and first_id of each strip are
        printed, for [strip] in the scene of a canister.

    Examples
    --------
    rhizotwin markers printed_8ml -o strip.pdf
    rhizotwin markers my_scene.toml -o strips.pdf --labels 18
    rhizotwin markers my_scene.toml -o strip.svg --page a3 --landscape
    rhizotwin markers my_scene.toml -o strip.pdf --printed-ruler-mm 99.6x99.8
    """
    from rhizotwin.catalogue.records import Tag
    from rhizotwin.rig.printing.print_files import write_pages
    from rhizotwin.rig.printing.print_strip import strip_pages

    drawn = files.load_scene(scene)
    scenes = [drawn] if labels is None else [_of_canister(drawn, number + 1) for number in range(labels)]
    pages = [one for each in scenes for one in strip_pages(each, paper=page.paper(), paper_mm=paper_mm)]
    written = write_pages(pages, output, title=f"marker strip of {drawn.name}")
    across_mm = 2.0 * drawn.net_pot.outer_radius_mm
    for number, each in enumerate(scenes if labels else (), start=1):
        print(f"canister {number}: {Tag.of_strip(each.strip)}")
    print(f"wrote the marker strip{'s' if labels else ''} of {drawn.name} to {', '.join(str(path) for path in written)}")
    print("print the pages at 100 % scale, measure the ruler, cut out the strip and glue it around the net pot")
    print(f"the outer diameter of the strip on the net pot must be {across_mm:.1f} mm")


def _of_canister(scene: Scene, number: int) -> Scene:
    """Return a copy of the scene with the marker strip of a numbered canister."""
    from rhizotwin.catalogue.identity import strip_for_canister

    return replace(scene, name=f"{scene.name}, canister {number}", strip=strip_for_canister(scene.strip, number))
