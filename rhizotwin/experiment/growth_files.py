"""Write the output folder of `rhizotwin growth`: growth curves, tables, figures and an HTML page."""

from collections.abc import Sequence
from pathlib import Path

from rhizotwin.experiment import growth, growth_page, mass_curves, uptake
from rhizotwin.experiment.measured import read_all
from rhizotwin.experiment.readings import is_of_readings, merge, read_readings
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, new_folder

PAGE = "growth.html"


def write(results: Sequence[Path], output: Path, *, replace: bool = False) -> list[str]:
    """Measure growth, write the output folder atomically, and return the findings as sentences.

    Parameters
    ----------
    results : sequence of Path
        Result folders, folders of results, tables of traits, of masses, and of the nutrient solution.
    output : Path
        Output folder.
    replace : bool
        Whether an earlier output of `rhizotwin growth` is replaced. Otherwise the folder must be new or empty.

    Raises
    ------
    UserError
        If a result has no plant or day, no value is reliable, or the folder cannot be written.
    """
    weighed = [path for path in results if mass_curves.is_of_masses(path)]
    logged = [path for path in results if is_of_readings(path)]
    others = [path for path in results if path not in weighed and path not in logged]
    measured = growth.measure(read_all(others)) if others or not (weighed or logged) else None
    treatments = {plant: days[0].subject.treatment for plant, days in measured.plants.items()} if measured is not None else {}
    masses, notes = mass_curves.read(weighed, treatments)
    curves = mass_curves.measure(masses)
    readings = merge([one for path in logged for one in read_readings(path)], treatments)
    taken_up = uptake.measure(readings, [] if measured is None else measured.seen.get("total_length", ()))
    notes += uptake.notes(readings, taken_up)
    if measured is None and not curves and not readings:
        raise UserError("; ".join(notes) or "the tables contain no masses and no readings; enter a value of at least one plant")
    picture = mass_curves.draw(curves) if curves else None
    solution = uptake.draw(readings, taken_up) if readings else None
    old = contents(output) if replace and (output / PAGE).is_file() else ()
    with new_folder(output, replaces=old) as building:
        if measured is not None:
            growth.write(measured, building)
        if measured is not None and measured.curves:
            atomic.write_bytes(building / "growth.png", growth_page.draw(measured))
        if measured is not None and measured.responses:
            atomic.write_bytes(building / "doses.png", growth_page.draw_responses(measured))
        if measured is not None and (together := growth.neighbours_csv(measured)):
            atomic.write_text(building / "neighbours.csv", together)
        if picture is not None:
            atomic.write_bytes(building / "masses.png", picture)
            atomic.write_text(building / "masses.csv", mass_curves.to_csv(curves))
        if solution is not None:
            atomic.write_bytes(building / "solution.png", solution)
            atomic.write_text(building / "uptake.csv", uptake.to_csv(taken_up))
        atomic.write_text(building / PAGE, growth_page.page(measured, picture, solution, notes))
    return [*([] if measured is None else growth_page.sentences(measured)), *notes]
