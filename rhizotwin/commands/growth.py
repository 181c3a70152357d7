"""Command `rhizotwin growth`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.steps.arguments import OutputFolder, with_metavar


def growth(results: Annotated[list[Path], with_metavar("RESULTS")], /, *, output: OutputFolder) -> None:
    """Compute growth curves of plants and individual roots, and compare treatments.

    Results of the same plant on several days are aligned, and each root is identified across days, which yields its day
    of emergence and its growth rate. Growth curves of length, volume, depth, root tips, leaves, leaf area and greenness
    show the mean of each day with its 90 % interval. Treatments are compared with a linear mixed model; if nutrient
    solutions differ, the response to each ion is fitted as well. Values that are not reliable are excluded, and their
    number is reported. The datasets must specify plant and day, and the treatment if there are several treatments. Mass
    tables, weighed or predicted, add curves of fresh mass, dry mass and water content. Tables of the nutrient solution
    add its readings, and the net uptake of ions per root length.

    Parameters
    ----------
    results : list of Path
        Result folders, folders that contain results, trait tables (.csv, for growth curves only), tables of masses or
        of the nutrient solution (.csv), or a catalogue (.rhizotwin) with its results and tables.
    output : Path
        Output folder for traits.csv, roots.csv, treatments.csv, growth.html, growth.png and RSML files of roots over
        time; depending on the data also doses.csv and doses.png (several nutrient solutions), masses.csv and masses.png
        (mass tables), uptake.csv and solution.png (tables of the nutrient solution), and neighbours.csv (plants that
        share a canister).

    Examples
    --------
    rhizotwin growth my_results -o my_growth
    rhizotwin growth my_results/traits.csv -o my_growth
    rhizotwin growth my.rhizotwin -o my_growth
    rhizotwin growth my_results my_masses.csv my_predicted_masses.csv -o my_growth
    rhizotwin growth my_results my_solution.csv -o my_growth
    """
    from rhizotwin.catalogue import sources
    from rhizotwin.experiment import growth_files

    for sentence in growth_files.write(sources.expand_results(results, tables=True, phantoms=False), output):
        print(sentence)
    print(f"report: {output / 'growth.html'}")
