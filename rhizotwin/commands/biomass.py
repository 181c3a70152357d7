"""Predict the mass of living plants from harvested ones.

Examples
--------
rhizotwin biomass tables -o thesis
rhizotwin biomass fit my_results my_masses.csv -o radish.json
rhizotwin biomass predict my_other_results --model radish.json
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rhizotwin.arguments import OutputFolder, between, named, option, output
from rhizotwin.experiment.masses import BALANCE_G
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from rhizotwin.experiment.biomass import Model, Pair

BALANCE_LIMITS_G = (1e-7, 10.0)

Results = Annotated[list[Path], named("RESULTS")]


def tables(*, output: OutputFolder) -> None:
    """Write the thesis's tables of masses and volumes.

    Masses of eighteen radishes, fresh and dry, root and shoot (table A.1), and the volumes that the thesis found for
    them (table 4.1), as CSV with their source: examples of what 'biomass fit' reads.

    Parameters
    ----------
    output : Path
        Folder to write them to.

    Examples
    --------
    rhizotwin biomass tables -o thesis
    """
    from rhizotwin.experiment.tables import write_shipped

    for path in write_shipped(output):
        print(f"wrote {path}")


def fit(
    results: Results,
    /,
    *,
    output: Annotated[Path, output("MODEL")],
    balance_g: Annotated[float, option(lambda text: between(text, BALANCE_LIMITS_G, "g", "grams"), "G")] = BALANCE_G,
) -> None:
    """Fit masses to volumes and other traits, with errors on both sides.

    Each kind of mass (root and shoot, fresh and dry) is fitted to volume, length, surface and leaf area, in proportion
    and as a power. What predicts a plant best that was left out is kept; its 90 % interval comes of the volume's
    interval, the balance, and how much plants differ. Traits that are not reliable are left out and counted.

    Parameters
    ----------
    results : list of Path
        Results, folders of results, or tables of traits (.csv); the last is the table of masses (.csv), or a catalogue
        (.rhizotwin), whose results and masses are used: columns plant,
        where wanted day, and root_fresh_g, root_dry_g, shoot_fresh_g, shoot_dry_g; with root_foil_g and
        root_foil_scraped_g what stuck to the foil is added.
    output : Path
        Model to write (JSON); must not exist yet.
    balance_g : float
        Readability of the balance.

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
        raise UserError("give results and, as the last, the table of masses (.csv), or a catalogue that has both")
    if output.exists():
        raise UserError(f"{output} exists already; choose another name")
    from rhizotwin.experiment import biomass, model_file
    from rhizotwin.experiment.masses import read_masses
    from rhizotwin.experiment.measured import read_all

    weighed = [one for table in tables for one in read_masses(table, balance_g=balance_g)]
    found, notes = biomass.pairs(read_all(sources.expand_results(given, phantoms=False)), weighed)
    model = biomass.fit(found, balance_g=balance_g, notes=notes)
    model_file.save_model(model, output)
    for note in model.notes:
        print(f"note: {note}")
    _say(model, found)
    print(f"wrote {output}")
    print(f"next: rhizotwin biomass predict OTHER_RESULTS --model {output}")


def predict(
    results: Results,
    /,
    *,
    model: Annotated[Path, named("MODEL")],
    table: Annotated[Path | None, output("FILE")] = None,
) -> None:
    """Predict the mass of plants that were not weighed, with 90 % intervals.

    Parameters
    ----------
    results : list of Path
        Results, folders of results, tables of traits (.csv), or a catalogue (.rhizotwin).
    model : Path
        Written by 'rhizotwin biomass fit', of the same species.
    table : Path, optional
        Table to write (.csv); must not exist yet.

    Examples
    --------
    rhizotwin biomass predict my_results --model radish.json
    rhizotwin biomass predict my_results --model radish.json -o masses.csv
    """
    if table is not None and (table.suffix.lower() != ".csv" or table.exists()):
        raise UserError(f"{table} {'exists already; choose another name' if table.exists() else 'must end in .csv'}")
    from rhizotwin.catalogue import sources
    from rhizotwin.experiment import model_file
    from rhizotwin.experiment.measured import read_all
    from rhizotwin.scenes import atomic

    found = model_file.predict(model_file.load_model(model), read_all(sources.expand_results(results, phantoms=False)))
    if not found:
        raise UserError(f"none of the results has a trait that {model} tells a mass by")
    for one in found:
        told = f"{one.measured.who}: {one.relation.kind} {one.grams:.4g} g, 90 % interval {one.low_g:.4g} to {one.high_g:.4g} g"
        cautions = [
            (one.assessment.verdict == "not reliable", f"not reliable: its {one.relation.trait} is not reliable"),
            (one.beyond, f"its {one.relation.trait} is beyond the model's plants"),
        ]
        print("; ".join([told, *(words for is_open, words in cautions if is_open)]))
    if table is not None:
        atomic.write_text(table, model_file.to_csv(found))
        print(f"wrote {table}")


def _say(model: "Model", found: "list[Pair]") -> None:
    """Print what was tried, and the densities."""
    import numpy as np

    from rhizotwin.experiment import biomass

    print(f"{'':2}{'mass from trait':<46}{'plants':>7}{'error':>9}{'held':>7}{'slope':>8}")
    for one in model.tried:
        mark = "*" if one in model.relations else ""
        print(f"{mark:2}{one.name:<46}{one.plants:>7}{100 * one.error:>8.1f}%{100 * one.held:>6.0f}%{one.line.slope:>8.3f}")
    print("error: of plants that were left out, root mean square; held: by the 90 % interval; *: kept")
    known = biomass.ratios(found)
    if known:
        print(f"mean of fresh root mass over volume: {np.mean([ratio for _, ratio in known]):.4g} g/ml of {len(known)} plants")
    for one in model.tried:
        if one.kind == "root_fresh" and one.trait == "volume" and one.proportional:
            middle, reach = one.line.intercept, one.line.reach(biomass.SHARE) * one.line.covariance[0][0] ** 0.5
            low, density, high = (1000.0 * float(np.exp(middle + side * reach)) for side in (-1.0, 0.0, 1.0))
            print(f"density of fresh roots by the fit: {density:.4g} g/ml, 90 % interval {low:.4g} to {high:.4g} g/ml")
