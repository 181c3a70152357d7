"""Tables of the MIAPPE 1.1 standard (Papoutsoglou et al. 2020, New Phytologist 227:260) for datasets and results.

Column names are those of the MIAPPE checklist. Unknown values are empty.
"""

from collections.abc import Sequence

from rhizotwin.publishing.published import Found, Scan
from rhizotwin.publishing.study import Study
from rhizotwin.scenes.solution import UNIT
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.trait_table import DEFINITIONS, csv_text, format_exact

_METHOD = "rhizotwin: refraction-aware reconstruction from pictures taken around the canister"


def tables(study: Study, scans: Sequence[Scan], results: Sequence[Found]) -> dict[str, str]:
    """Return the MIAPPE tables as CSV text, keyed by file name.

    Parameters
    ----------
    study : Study
        Description of the data.
    scans, results : sequence of Scan, sequence of Found
        Published scans and results.
    """
    rows: dict[str, list[list[str]]] = {
        "study": _study(study),
        "person": [["Person name", "Person email", "Person ID", "Person role", "Person affiliation"], *_people(study)],
        "biological_material": [["Biological material ID", "Organism", "Genus", "Species"], *_materials(scans, results)],
        "factor": [[f"Experimental Factor {what}" for what in ("type", "description", "values")], *_factors(scans)],
        "observation_unit": [_UNIT_HEAD, *_units(scans)],
        "observed_variable": [["Variable ID", "Variable name", "Trait", "Method", "Scale"], *_variables(results)],
        "data_file": [["Data file link", "Data file description", "Data file version"], *_files(scans, results)],
    }
    return {f"{name}.csv": csv_text(table) for name, table in rows.items()}


def _study(study: Study) -> list[list[str]]:
    return [
        ["Study title", study.title],
        ["Study description", study.description],
        ["Start date of study", study.start],
        ["Contact institution", study.institution],
        ["Geographic location (country)", study.country],
        ["Type of growth facility", study.facility],
        ["Cultural practices", study.cultivation],
        ["Associated publication", study.publication_doi],
        ["License", study.licence],
        ["MIAPPE version", "1.1"],
    ]


def _people(study: Study) -> list[list[str]]:
    roles = ["data submitter", *["author"] * len(study.authors)]
    return [[one.name, one.email, one.orcid, role, one.affiliation] for one, role in zip(study.authors, roles, strict=False)]


def subjects(scan: Scan) -> list[Subject]:
    """Return all plants in a scan."""
    scene = scan.dataset.scene
    return [plant.subject(scene.subject) for plant in scene.plants] or [scene.subject]


def _materials(scans: Sequence[Scan], results: Sequence[Found]) -> list[list[str]]:
    whole = [one for scan in scans for one in subjects(scan)] + [own.subject for found in results for own in found.plants]
    species = dict.fromkeys(one.species for one in whole if one.species)
    return [[name, name, *[*name.split(maxsplit=1), ""][:2]] for name in species]


def _factors(scans: Sequence[Scan]) -> list[list[str]]:
    treatments = dict.fromkeys(one.treatment for scan in scans for one in subjects(scan) if one.treatment)
    solutions = dict.fromkeys(str(scan.dataset.scene.solution) for scan in scans if scan.dataset.scene.solution.known)
    described = (
        ("treatment", "name given by the experimenter", treatments),
        ("growing medium composition", f"nutrient solution; ions in {UNIT} in traits.csv", solutions),
    )
    return [[kind, description, "; ".join(values)] for kind, description, values in described if values]


_UNIT_HEAD = [
    "Observation unit ID",
    "Observation unit type",
    "Biological material ID",
    "Observation unit factor value",
    "Replicate",
    "Days after sowing",
    "Observation date",
    "Data file link",
]


def _units(scans: Sequence[Scan]) -> list[list[str]]:
    rows = []
    for scan in scans:
        for one in subjects(scan):
            factors = "; ".join(filter(None, [one.treatment, str(scan.dataset.scene.solution)]))
            replicate = "" if one.replicate is None else str(one.replicate)
            rows.append(
                [one.plant or scan.name, "plant", one.species, factors, replicate, format_exact(one.day), one.date, f"{scan.place}/"]
            )
    return rows


def _variables(results: Sequence[Found]) -> list[list[str]]:
    return [[d.column, d.heading, d.meaning, _METHOD, d.unit or "1"] for d in DEFINITIONS] if results else []


def _files(scans: Sequence[Scan], results: Sequence[Found]) -> list[list[str]]:
    rows = [[f"{scan.place}/", f"{len(scan.dataset.frames)} pictures with scene and rig data", ""] for scan in scans]
    rows += [[f"{one.place}/", "shape, roots, traits and report", one.version] for one in results]
    return rows + ([["traits.csv", "traits of all results, with intervals and verdicts", ""]] if results else [])
