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
        Result folders, folders that contain results, tables of traits (.csv; growth curves only) or tables of masses
        (.csv).
    output : Path
        Folder to write: traits.csv, roots.csv, treatments.csv, growth.html, growth.png and RSML files with time; for
        several nutrient solutions also doses.csv and doses.png, for masses masses.csv and masses.png, for plants that
        share a canister neighbours.csv.

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
    print(f"report: {output / 'growth.html'}")
