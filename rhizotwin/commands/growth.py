"""`rhizotwin growth`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import OutputFolder, named


def growth(results: Annotated[list[Path], named("RESULTS")], /, *, output: OutputFolder) -> None:
    """Follow plants and their roots over days, and compare treatments.

    Results of one plant on several days are laid on each other, and every root gets an identity through time: when it
    came, how fast it grew. Curves of length, volume, depth and root ends have a mean a day with its 90 % interval, and
    treatments are compared by a linear mixed model. Where nutrient solutions differ, the response to each ion is fitted
    in the same way. Values that are not reliable are left out and counted. The datasets
    must say plant and day, and the treatment where there are several. Tables of masses, weighed or predicted, give
    curves of wet mass, dry mass and water content, beside results or alone.

    Parameters
    ----------
    results : list of Path
        Results, folders of results, tables of traits (.csv), which have curves but no roots to follow, and tables of
        masses (.csv).
    output : Path
        Folder to make: traits.csv, roots.csv, treatments.csv, growth.html, growth.png, and roots as RSML with time; of
        nutrient solutions doses.csv and doses.png; of masses masses.csv and masses.png; of plants that share a canister
        neighbours.csv.

    Examples
    --------
    rhizotwin growth my_results -o my_growth
    rhizotwin growth my_results/traits.csv -o my_growth
    rhizotwin growth my_results my_masses.csv my_predicted_masses.csv -o my_growth
    """
    from rhizotwin.experiment import growth as grown
    from rhizotwin.experiment import growth_page, mass_curves
    from rhizotwin.experiment.measured import read_all
    from rhizotwin.scenes import atomic
    from rhizotwin.scenes.folders import new_folder

    weighed = [path for path in results if mass_curves.is_of_masses(path)]
    others = [path for path in results if path not in weighed]
    curves = mass_curves.measure(mass_curves.read(weighed))
    measured = grown.measure(read_all(others)) if others or not weighed else None
    picture = mass_curves.draw(curves) if curves else None
    with new_folder(output) as building:
        if measured is not None:
            grown.write(measured, building)
        if measured is not None and measured.curves:
            atomic.write_bytes(building / "growth.png", growth_page.draw(measured))
        if measured is not None and measured.responses:
            atomic.write_bytes(building / "doses.png", growth_page.draw_responses(measured))
        if measured is not None and (together := grown.neighbours_csv(measured)):
            atomic.write_text(building / "neighbours.csv", together)
        if picture is not None:
            atomic.write_bytes(building / "masses.png", picture)
            atomic.write_text(building / "masses.csv", mass_curves.to_csv(curves))
        atomic.write_text(building / "growth.html", growth_page.page(measured, picture))
    for sentence in [] if measured is None else growth_page.sentences(measured):
        print(sentence)
    print(f"look at it: {output / 'growth.html'}")
