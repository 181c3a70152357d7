"""Predict the mass of living plants with a model fitted to harvested plants.

The model relates the weighed mass of harvested plants to the volume or another trait in their scans.

Examples
--------
rhizotwin biomass tables -o thesis
rhizotwin biomass example -o eighteen_plants
rhizotwin biomass fit my_results my_masses.csv -o radish.json
rhizotwin biomass predict my_other_results --model radish.json
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rhizotwin.experiment.masses import BALANCE_G
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.steps.arguments import OutputFolder, check_new_file, option, output, read_number, with_metavar

if TYPE_CHECKING:
    from rhizotwin.experiment.biomass import Model, Pair

BALANCE_LIMITS_G = (1e-7, 10.0)

Results = Annotated[list[Path], with_metavar("RESULTS")]


def tables(*, output: OutputFolder) -> None:
    """Write the example tables of masses and volumes from Kliman's thesis (2022).

    The CSV files contain the fresh and dry masses of roots and shoots of eighteen radishes (table A.1), and the root
    volumes measured in the thesis (table 4.1). They can be used as input for 'biomass fit'.

    Parameters
    ----------
    output : Path
        Output folder.

    Examples
    --------
    rhizotwin biomass tables -o thesis
    """
    from rhizotwin.experiment.thesis_tables import write_shipped

    for path in write_shipped(output):
        print(f"wrote {path}")


def example(*, output: OutputFolder) -> None:
    """Write the results of eighteen simulated plants, scanned several times, and a table of their masses.

    The plants are those of Kliman's thesis (2022), three of which were harvested and weighed every five days. The scans
    are simulated and reconstructed. The results contain the traits and the roots, but no pictures.

    Parameters
    ----------
    output : Path
        Output folder, with the results in the subfolder results and the masses in masses.csv.

    Examples
    --------
    rhizotwin biomass example -o eighteen_plants
    rhizotwin growth eighteen_plants/results eighteen_plants/masses.csv -o my_growth
    """
    from rhizotwin.experiment.thesis_tables import write_example

    write_example(output)
    print(f"wrote {output}")
    print(f"next: rhizotwin growth {output / 'results'} {output / 'masses.csv'} -o my_growth")


def fit(
    results: Results,
    /,
    *,
    output: Annotated[Path, output("MODEL")],
    balance_g: Annotated[float, option(lambda text: read_number(text, BALANCE_LIMITS_G, "g", "grams"), "G")] = BALANCE_G,
) -> None:
    """Fit a model that predicts mass from volume or another trait, with errors in both variables.

    Each type of mass (root or shoot, fresh or dry) is fitted as a function of volume, length, surface and leaf area,
    with a proportional law and with a power law. For each type of mass, the model with the smallest leave-one-out error
    is selected. Its 90 % intervals combine the interval of the trait, the readability of the balance and the variation
    among plants. Traits that are not reliable are excluded, and their number is printed.

    Parameters
    ----------
    results : list of Path
        Result folders, folders that contain results, or trait tables (.csv), followed by the mass table (.csv); or a
        catalogue (.rhizotwin), whose results and masses are used. The mass table has the columns plant, optionally day,
        and any of root_fresh_g, root_dry_g, shoot_fresh_g and shoot_dry_g. The dry matter left on the foil,
        root_foil_scraped_g - root_foil_g, is added to root_dry_g.
    output : Path
        Model file to write (JSON); must not exist yet.
    balance_g : float
        Readability (smallest displayed step) of the balance in grams.

    Examples
    --------
    rhizotwin biomass fit my_results my_masses.csv -o radish.json
    rhizotwin biomass fit thesis/kliman_2022_volumes.csv thesis/kliman_2022_masses.csv -o thesis.json
    """
    from rhizotwin.catalogue import sources

    *given, last = results
    tables = sources.mass_tables(last) if sources.is_catalogue(last) else [last]
    given = [*given, last] if sources.is_catalogue(last) else given
    if not given or any(table.suffix.lower() != ".csv" for table in tables):
        raise UserError("the fit needs results and masses; give results followed by the mass table (.csv), or a catalogue with both")
    check_new_file(output)
    from rhizotwin.experiment import biomass, model_file
    from rhizotwin.experiment.masses import read_masses
    from rhizotwin.experiment.measured import read_all

    weighed = [one for table in tables for one in read_masses(table, balance_g=balance_g)]
    found, notes = biomass.pairs(read_all(sources.expand_results(given, phantoms=False)), weighed)
    model = biomass.fit(found, balance_g=balance_g, notes=notes)
    model_file.save_model(model, output)
    for note in model.notes:
        print(f"note: {note}")
    _print_fits(model, found)
    print(f"wrote {output}")
    print(f"next: rhizotwin biomass predict OTHER_RESULTS --model {output}")


def predict(
    results: Results,
    /,
    *,
    model: Annotated[Path, with_metavar("MODEL")],
    table: Annotated[Path | None, output("FILE")] = None,
) -> None:
    """Predict the mass of plants that were not weighed, with 90 % intervals.

    Parameters
    ----------
    results : list of Path
        Result folders, folders that contain results, trait tables (.csv), or a catalogue (.rhizotwin).
    model : Path
        Model file, written by 'rhizotwin biomass fit' for plants of the same species.
    table : Path, optional
        CSV table to write; must not exist yet.

    Examples
    --------
    rhizotwin biomass predict my_results --model radish.json
    rhizotwin biomass predict my_results --model radish.json -o masses.csv
    """
    if table is not None:
        check_new_file(table, ".csv")
    from rhizotwin.catalogue import sources
    from rhizotwin.experiment import model_file
    from rhizotwin.experiment.measured import read_all
    from rhizotwin.scenes import atomic

    found = model_file.predict(model_file.load_model(model), read_all(sources.expand_results(results, phantoms=False)))
    if not found:
        raise UserError(f"no result has a trait that the model {model} needs; give results of the same kind as those for the fit")
    for one in found:
        predicted = f"{one.measured.who}: {one.relation.kind} {one.grams:.4g} g, 90 % interval {one.low_g:.4g} to {one.high_g:.4g} g"
        cautions = [
            (one.assessment.verdict == "not reliable", f"not reliable, because the {one.relation.trait} is not reliable"),
            (one.beyond, f"extrapolated, because the {one.relation.trait} is outside the range of the model's plants"),
        ]
        print("; ".join([predicted, *(words for is_open, words in cautions if is_open)]))
    if table is not None:
        atomic.write_text(table, model_file.to_csv(found))
        print(f"wrote {table}")


def _print_fits(model: "Model", found: "list[Pair]") -> None:
    """Print a table of all fitted relations, and the density of fresh roots."""
    import numpy as np

    from rhizotwin.experiment import biomass

    print(f"{'':2}{'mass from trait':<46}{'plants':>7}{'error':>9}{'covered':>9}{'slope':>8}")
    for one in model.tried:
        mark = "*" if one in model.relations else ""
        print(f"{mark:2}{one.name:<46}{one.plants:>7}{100 * one.error:>8.1f}%{100 * one.held:>8.0f}%{one.line.slope:>8.3f}")
    print("error: RMS leave-one-out error; covered: fraction of plants within their 90 % interval; *: selected relation")
    own: dict[str, list[float]] = {}
    for pair, ratio in biomass.ratios(found):
        own.setdefault(pair.measured.subject.plant, []).append(ratio)
    if own:
        mean = np.mean([np.mean(days) for days in own.values()])
        print(f"fresh root mass per volume: mean {mean:.4g} g/ml of {count(len(own), 'plant')}")
    for one in model.tried:
        if one.kind == "root_fresh" and one.trait == "volume" and one.proportional:
            middle = one.line.intercept
            reach = one.line.reach(biomass.SHARE) * one.line.covariance[0][0] ** 0.5
            low, density, high = (1000.0 * float(np.exp(middle + side * reach)) for side in (-1.0, 0.0, 1.0))
            print(f"fitted density of fresh roots: {density:.4g} g/ml, 90 % interval {low:.4g} to {high:.4g} g/ml")
