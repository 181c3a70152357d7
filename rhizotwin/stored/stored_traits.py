"""Read or measure the traits of stored results, and tabulate them for many results."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rhizotwin.recon.results.parts import Json, Mesh
from rhizotwin.recon.results.reasons import shorten
from rhizotwin.recon.results.result_traits import describe_edits, measure_shape, traits_by_plant
from rhizotwin.scenes import solution, subject, trait_table
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import Place, from_plain
from rhizotwin.scenes.traits import Traits, weighed
from rhizotwin.stored import result_files


def read(result_folder: Path, *, mass_g: float | None = None) -> Traits:
    """Read the traits of a result folder. The default mass is the mass recorded in the result.

    Traits that ``result.json`` does not contain are measured on the roots and the surface of the result.

    Raises
    ------
    UserError
        If a file of the result is missing or damaged.
    """
    summary = result_files.read_summary(result_folder)
    if "traits" not in summary:
        return of_summary(
            summary, result_files.read_mesh(result_folder / "shape.ply"), result_files.read_roots(result_folder), mass_g=mass_g
        )
    traits = from_plain(Traits, summary["traits"], Place(str(result_folder / "result.json")).at("traits"))
    return traits if mass_g is None else weighed(traits, mass_g)


def of_summary(summary: Json, surface: Mesh, roots: Sequence[Root], *, mass_g: float | None = None) -> Traits:
    """Measure the traits of a result from its ``result.json``, its surface and its roots.

    Parameters
    ----------
    summary : Json
        Content of ``result.json``.
    surface, roots : Mesh, sequence of Root
        Surface and roots of the result.
    mass_g : float or None
        Mass of the roots, g. None: the mass in ``summary``.

    Returns
    -------
    Traits
        Traits of all plants together.
    """
    return measure_shape(
        surface,
        roots,
        volume_mm3=float(summary["volume_mm3"]),
        finest_mm=result_files.finest_mm(summary),
        mass_g=summary.get("mass_g") if mass_g is None else mass_g,
        extents_mm=(summary["extents_min_mm"], summary["extents_max_mm"]),
    )


def spreadsheet(rows: Sequence[tuple[str, Json, Traits]]) -> str:
    """Return a CSV table with one row per result, or per plant if a result contains several plants.

    The columns are name, scene, subject, ion concentrations of the nutrient solution if known, traits with their units
    in the column names, 90 % intervals, verdicts on the traits, reason codes of the verdict on the volume, edits and
    warnings.

    Parameters
    ----------
    rows : sequence of tuple of str
        Name, content of ``result.json`` and traits of each result.
    """
    shoots = [shoot for _, summary, _ in rows if (shoot := of_shoot(summary))]
    above = [*trait_table.SHOOT, *(d for d in trait_table.COLOUR if any(d.field in shoot for shoot in shoots))] if shoots else []
    found = [(name, summary, one) for name, summary, traits in rows for one in traits_by_plant(name, summary, traits)]
    ranged = [d for d in trait_table.DEFINITIONS if d.field in trait_table.WITH_INTERVAL]
    intervals = [f"{d.column}_{end}" for d in ranged for end in ("low", "high")]
    verdicts = [f"{d.column}_verdict" for d in trait_table.DEFINITIONS]
    headings = [d.column for d in (*trait_table.DEFINITIONS, *above)]
    ions = [solution.from_summary(summary, name).ions_mmol_per_l for name, summary, _ in found]
    dissolved = solution.headings(ions)
    head = ["result", "scene", *subject.NAMES, *dissolved.values(), *headings, *intervals, *verdicts, "reasons", "edits", "warnings"]
    table: list[Sequence[Any]] = [head]
    for (name, summary, one), own in zip(found, ions, strict=True):
        values = [getattr(one.traits, d.field) for d in trait_table.DEFINITIONS]
        shoot = trait_table.shoot_numbers(of_shoot(summary))
        values += [shoot.get(d.name) for d in above]
        values += [end for d in ranged for end in one.assessed[d.field].interval or (None, None)]
        numbers = [trait_table.format_exact(value) for value in [*(own.get(ion) for ion in dissolved), *values]]
        judged = [one.assessed[d.field].verdict for d in trait_table.DEFINITIONS]
        codes = ";".join(one.assessed["volume_mm3"].codes)
        warnings = shorten([str(warning) for warning in summary["warnings"]])
        whose = subject.as_text(one.subject).values()
        table.append([name, summary["scene"], *whose, *numbers, *judged, codes, describe_edits(summary), warnings])
    return trait_table.csv_text(table)


def of_shoot(summary: Json) -> Json | None:
    """Return the entry ``shoot`` of ``result.json``.

    Return None if there is no shoot, or if the result contains several plants, whose shoots are not separated.
    """
    return None if len(summary.get("plants") or ()) > 1 else summary.get("shoot")
