"""Tables of the MIAPPE standard (Papoutsoglou et al. 2020, New Phytologist 227:260) for datasets and results.

Each section of the checklist is a table with the names of the checklist in its first line, and the identifiers of the
investigation and of the study in its first two columns. Unknown values are empty. Versions 1.1 and 1.2 have the same
names for all fields that are written.
"""

import uuid
from collections.abc import Sequence
from typing import Any

from rhizotwin.publishing.published import Found, Scan
from rhizotwin.publishing.study import Study
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.solution import UNIT
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.trait_table import DEFINITIONS, csv_text

VERSION = "1.1"
"""Version of the checklist that is stated. Version 1.2 is compatible with it."""
_METHOD = "rhizotwin: refraction-aware reconstruction from pictures taken around the canister"
_IDS = ("Investigation unique ID", "Study unique ID")
Table = dict[str, list[str]]
"""Values of the rows, keyed by name of the field."""


def tables(study: Study, scans: Sequence[Scan], results: Sequence[Found]) -> dict[str, str]:
    """Return the MIAPPE tables as CSV text, keyed by file name.

    Parameters
    ----------
    study : Study
        Description of the data.
    scans, results : sequence of Scan, sequence of Found
        Published scans and results.
    """
    investigation = study.identifier or _identifier(study, scans, results)
    found = {
        "investigation": _investigation(study),
        "study": _study(study, scans, results),
        "person": _people(study),
        "biological_material": _materials(scans, results),
        "environment": _environment(scans),
        "factor": _factors(scans),
        "observation_unit": _units(scans, results),
        "observed_variable": _variables(results),
        "data_file": _files(scans, results),
    }
    texts = {}
    for name, columns in found.items():
        ids = (investigation, f"{investigation}/study")[: 1 if name == "investigation" else 2]
        rows = zip(*columns.values(), strict=True)
        texts[f"{name}.csv"] = csv_text([[*_IDS[: len(ids)], *columns], *([*ids, *row] for row in rows)])
    return texts


def missing(study: Study, scans: Sequence[Scan], results: Sequence[Found]) -> list[str]:
    """Return the keys of the study file and scenes whose values MIAPPE requires, but which are unknown."""
    values = _study(study, scans, results)
    keys = {"Start date of study": "start", "Contact institution": "institution", "Geographic location (country)": "country"}
    known = [author.affiliation for author in study.authors]
    found = [key for name, key in keys.items() if values[name] == [""]] + (["affiliation (authors)"] if not all(known) else [])
    return found + ([] if _materials(scans, results)["Organism"] else ["species ([subject] of the scenes)"])


def _identifier(study: Study, scans: Sequence[Scan], results: Sequence[Found]) -> str:
    """Return an identifier (UUID of version 5) that is the same for the same data and title."""
    hashes = {scan.dataset.sha256 for scan in scans} | {str(found.summary["dataset_sha256"]) for found in results}
    return uuid.uuid5(uuid.NAMESPACE_URL, "\n".join([study.title, *sorted(hashes)])).urn


def _investigation(study: Study) -> Table:
    return {
        "Investigation title": [study.title],
        "Investigation description": [study.description],
        "Public release date": [study.published],
        "License": [study.licence_url],
        "MIAPPE version": [VERSION],
        "Associated publication": [f"doi:{study.publication_doi}" if study.publication_doi else ""],
    }


def _study(study: Study, scans: Sequence[Scan], results: Sequence[Found]) -> Table:
    plants = _subjects(scans, results)
    institution = study.institution or next((one.affiliation for one in study.authors if one.affiliation), "")
    different: dict[str, set[Any]] = {
        "plant": {name for name, _ in plants},
        "treatment": {one.treatment for _, one in plants if one.treatment},
        "day": {one.day for _, one in plants if one.day is not None},
    }
    design = ", ".join(count(len(values), word) for word, values in different.items() if values)
    return {
        "Study title": [study.title],
        "Study description": [study.description],
        "Start date of study": [study.start or min((one.date for _, one in plants if one.date), default="")],
        "End date of study": [study.end],
        "Contact institution": [institution],
        "Geographic location (country)": [study.country],
        "Experimental site name": [study.site or institution],
        "Description of the experimental design": [study.design or design],
        "Observation unit level hierarchy": ["rep>plant" if any(one.replicate is not None for _, one in plants) else "plant"],
        "Observation unit description": ["plant in a canister of nutrient solution, photographed from all sides"],
        "Description of growth facility": [study.facility],
        "Cultural practices": [study.cultivation],
    }


def _people(study: Study) -> Table:
    return {
        "Person name": [one.name for one in study.authors],
        "Person email": [one.email for one in study.authors],
        "Person ID": [f"orcid.org/{one.orcid}" if one.orcid else "" for one in study.authors],
        "Person role": ["data submitter; author", *["author"] * len(study.authors)][: len(study.authors)],
        "Person affiliation": [one.affiliation for one in study.authors],
    }


def subjects(scan: Scan) -> list[Subject]:
    """Return all plants in a scan."""
    scene = scan.dataset.scene
    return [plant.subject(scene.subject) for plant in scene.plants] or [scene.subject]


def _subjects(scans: Sequence[Scan], results: Sequence[Found]) -> list[tuple[str, Subject]]:
    """Return the plants in all scans, and in results without a scan, with the names of their observation units."""
    own = [(one.plant or scan.name, one) for scan in scans for one in subjects(scan)]
    return own + [(one.subject.plant or found.name, one.subject) for found in results if found.scan is None for one in found.plants]


def _materials(scans: Sequence[Scan], results: Sequence[Found]) -> Table:
    species = list(dict.fromkeys(one.species for _, one in _subjects(scans, results) if one.species))
    words = [[*name.split(maxsplit=1), ""][:2] for name in species]
    return {
        "Biological material ID": [_material_id(name) for name in species],
        "Organism": species,
        "Genus": [one[0] for one in words],
        "Species": [one[1] for one in words],
    }


def _material_id(species: str) -> str:
    """Return an identifier of a species without spaces, which validators reject."""
    return "_".join(species.split())


def _conditions(scans: Sequence[Scan]) -> dict[str, tuple[str, list[str]]]:
    """Return description and values of the conditions of the plants, keyed by their type."""
    treatments = dict.fromkeys(one.treatment for scan in scans for one in subjects(scan) if one.treatment)
    solutions = dict.fromkeys(str(scan.dataset.scene.solution) for scan in scans if scan.dataset.scene.solution.known)
    return {
        "treatment": ("name given by the experimenter", list(treatments)),
        "growing medium composition": (f"nutrient solution; ions in {UNIT} in traits.csv", list(solutions)),
    }


def _environment(scans: Sequence[Scan]) -> Table:
    """Return the conditions that are the same for all plants."""
    constant = {kind: values[0] for kind, (_, values) in _conditions(scans).items() if len(values) == 1}
    return {"Environment parameter": list(constant), "Environment parameter value": list(constant.values())}


def _factors(scans: Sequence[Scan]) -> Table:
    """Return the conditions that differ between plants."""
    varying = {kind: one for kind, one in _conditions(scans).items() if len(one[1]) > 1}
    return {
        "Experimental Factor type": list(varying),
        "Experimental Factor description": [description for description, _ in varying.values()],
        "Experimental Factor values": ["; ".join(values) for _, values in varying.values()],
    }


def _units(scans: Sequence[Scan], results: Sequence[Found]) -> Table:
    """Return one row per plant. A plant that was scanned on several days is one observation unit."""
    varying = _factors(scans)["Experimental Factor type"]
    units: dict[str, Subject] = {}
    for name, one in _subjects(scans, results):
        units.setdefault(name, one)
    solutions = {one.plant or scan.name: str(scan.dataset.scene.solution) for scan in scans for one in subjects(scan)}
    known = {"treatment": {name: one.treatment for name, one in units.items()}, "growing medium composition": solutions}
    return {
        "Observation unit ID": list(units),
        "Observation unit type": ["plant"] * len(units),
        "Biological material ID": [_material_id(one.species) for one in units.values()],
        "Spatial distribution": ["" if one.replicate is None else f"rep:{one.replicate}" for one in units.values()],
        "Observation Unit factor value": ["; ".join(filter(None, (known[kind].get(name) for kind in varying))) for name in units],
    }


def _variables(results: Sequence[Found]) -> Table:
    measured = DEFINITIONS if results else ()
    return {
        "Variable ID": [d.column for d in measured],
        "Variable name": [d.heading for d in measured],
        "Trait": [d.meaning for d in measured],
        "Method": [_METHOD] * len(measured),
        "Scale": [d.unit or "1" for d in measured],
    }


def _files(scans: Sequence[Scan], results: Sequence[Found]) -> Table:
    rows = [
        (scan.place, f"{len(scan.dataset.frames)} pictures of {'; '.join(str(one) for one in subjects(scan)) or scan.name}", "")
        for scan in scans
    ]
    rows += [(one.place, "shape, roots, traits and report", one.version) for one in results]
    rows += [("traits.csv", "traits of all results, with intervals and verdicts", "")] if results else []
    return {name: [row[k] for row in rows] for k, name in enumerate(("Data file link", "Data file description", "Data file version"))}
