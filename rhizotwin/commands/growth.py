"""`rhizotwin growth`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import OutputFolder, with_metavar


def growth(results: Annotated[list[Path], with_metavar("RESULTS")], /, *, output: OutputFolder) -> None:
    """Track plants and single roots over time, and compare treatments.

    Results of the same plant on several days are aligned, and each root is matched across days to find its day of
    emergence and its growth rate. Growth curves of length, volume, depth and number of root tips show the mean of each
    day with its 90 % interval. Treatments are compared with a linear mixed model; if nutrient solutions differ, the
    response to each ion is fitted in the same way. Values that are not reliable are excluded; their number is reported.
    The datasets must contain plant and day, and the treatment if there are several. Tables of masses, weighed or
    predicted, add curves of fresh mass, dry mass and water content.

    Parameters
    ----------
    results : list of Path
        Result folders, folders that contain results, tables of traits (.csv; growth curves only), tables of masses
        (.csv), or a catalogue (.rhizotwin) with its results and masses.
    output : Path
        Folder to write: traits.csv, roots.csv, treatments.csv, growth.html, growth.png and RSML files with time; for
        several nutrient solutions also doses.csv and doses.png, for masses masses.csv and masses.png, for plants that
        share a canister neighbours.csv.

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
    print(f"report: {output / 'growth.html'}")
