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
        Results, folders of results, tables of traits (.csv), which have curves but no roots to follow, tables of masses
        (.csv), and a catalogue (.rhizotwin) with its results and masses.
    output : Path
        Folder to make: traits.csv, roots.csv, treatments.csv, growth.html, growth.png, and roots as RSML with time; of
        nutrient solutions doses.csv and doses.png; of masses masses.csv and masses.png; of plants that share a canister
        neighbours.csv.

    Examples
    --------
    rhizotwin growth my_results -o my_growth
    rhizotwin growth my_results/traits.csv -o my_growth
    rhizotwin growth my.rhizotwin -o my_growth
    rhizotwin growth my_results my_masses.csv my_predicted_masses.csv -o my_growth
    """
    from rhizotwin.catalogue import sources
    from rhizotwin.experiment import growth_files

    for sentence in growth_files.write(sources.expand_results(results, masses=True, phantoms=False), output):
        print(sentence)
    print(f"look at it: {output / 'growth.html'}")
