"""`rhizotwin growth`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import OutputFolder, named


def growth(results: Annotated[list[Path], named("RESULTS")], /, *, output: OutputFolder) -> None:
    """Follow plants and their roots over days, and compare treatments.

    Results of one plant on several days are laid on each other, and every root gets an identity through time: when it
    came, how fast it grew. Curves of length, volume, depth and root ends have a mean a day with its 90 % interval, and
    treatments are compared by a linear mixed model. Values that are not reliable are left out and counted. The datasets
    must say plant and day, and the treatment where there are several.

    Parameters
    ----------
    results : list of Path
        Results, folders of results, or tables of traits (.csv), which have curves but no roots to follow.
    output : Path
        Folder to make: traits.csv, roots.csv, treatments.csv, growth.html, growth.png, and roots as RSML with time.

    Examples
    --------
    rhizotwin growth my_results -o my_growth
    rhizotwin growth my_results/traits.csv -o my_growth
    """
    from rhizotwin.experiment import growth as grown
    from rhizotwin.experiment import growth_page
    from rhizotwin.experiment.measured import read_all
    from rhizotwin.scenes import atomic
    from rhizotwin.scenes.folders import new_folder

    measured = grown.measure(read_all(results))
    with new_folder(output) as building:
        atomic.write_text(building / "traits.csv", grown.traits_csv(measured))
        atomic.write_text(building / "roots.csv", grown.roots_csv(measured))
        atomic.write_text(building / "treatments.csv", grown.treatments_csv(measured))
        if measured.curves:
            atomic.write_bytes(building / "growth.png", growth_page.draw(measured))
        atomic.write_text(building / "growth.html", growth_page.page(measured))
        if measured.followed:
            (building / "rsml").mkdir()
            grown.write_rsml(measured, building / "rsml")
    for sentence in growth_page.sentences(measured):
        print(sentence)
    print(f"look at it: {output / 'growth.html'}")
