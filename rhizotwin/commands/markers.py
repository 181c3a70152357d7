"""`rhizotwin markers`."""

from typing import Annotated

from rhizotwin.arguments import OutputFile, SceneName, option, read_length_mm
from rhizotwin.pages import PageOptions
from rhizotwin.scenes import files

PAPER_LIMITS_MM = (0.0, 2.0)


def read_paper_mm(text: str) -> float:
    """Read the thickness of paper in mm."""
    return read_length_mm(text, PAPER_LIMITS_MM)


def markers(
    scene: SceneName,
    /,
    *,
    output: OutputFile,
    page: PageOptions = PageOptions(),
    paper_mm: Annotated[float, option(read_paper_mm, "MM")] = 0.1,
) -> None:
    """Write the marker strip of a scene for printing at true scale.

    The strip is written as PDF or SVG pages with cut marks, glue tabs and a ruler for checking the scale of the print.
    Several SVG pages are numbered: strip-1.svg, strip-2.svg, ...

    Parameters
    ----------
    scene : str
        Name of a scene (listed by 'rhizotwin scenes') or path of a scene file (TOML).
    output : Path
        File to write, .pdf or .svg; must not exist yet.
    page : PageOptions
        Paper.
    paper_mm : float
        Thickness of the paper. The strip is sized so that net_pot.outer_radius_mm of the scene is the outer radius of
        the glued paper.

    Examples
    --------
    rhizotwin markers printed_8ml -o strip.pdf
    rhizotwin markers my_scene.toml -o strip.svg --page a3 --landscape
    rhizotwin markers my_scene.toml -o strip.pdf --printed-ruler-mm 99.6x99.8
    """
    from rhizotwin.rig.printing.print_files import write_pages
    from rhizotwin.rig.printing.print_strip import strip_pages

    drawn = files.load_scene(scene)
    written = write_pages(strip_pages(drawn, paper=page.paper(), paper_mm=paper_mm), output, title=f"marker strip of {drawn.name}")
    across_mm = 2.0 * drawn.net_pot.outer_radius_mm
    print(f"wrote the marker strip of {drawn.name} to {', '.join(str(path) for path in written)}")
    print("print at 100 % scale, measure the ruler, cut out the strip and glue it around the net pot")
    print(f"the outer diameter of the strip on the pot must be {across_mm:.1f} mm")
