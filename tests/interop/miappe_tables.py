"""Check the MIAPPE tables of a published folder with metaseed, which is not installed in CI."""

import csv
import json
from pathlib import Path

from tests.interop.environment import install, run

PACKAGE = "metaseed==0.69.0"
FIELDS = {
    "study": {"Study title": "title", "Start date of study": "start_date", "Description of growth facility": "growth_facility_type"},
    "person": {"Person name": "name", "Person email": "email", "Person role": "role", "Person affiliation": "institution"},
    "biological_material": {"Biological material ID": "unique_id", "Organism": "organism", "Genus": "genus", "Species": "species"},
    "environment": {"Environment parameter": "parameter", "Environment parameter value": "value"},
    "factor": {"Experimental Factor type": "name", "Experimental Factor description": "description"},
    "observation_unit": {"Observation unit ID": "unique_id", "Observation unit type": "observation_unit_type"},
    "observed_variable": {"Variable ID": "unique_id", "Variable name": "name", "Trait": "trait", "Method": "method", "Scale": "scale"},
    "data_file": {"Data file link": "link", "Data file description": "description", "Data file version": "version"},
}
"""Names of the checklist's fields in metaseed, by table."""


def check(folder: Path, environment: Path) -> dict[str, tuple[float, float]]:
    """Validate the tables of a folder that ``rhizotwin export --publish`` wrote, against MIAPPE 1.1 and 1.2.

    The program is installed into the folder ``environment``. The result contains the number of rows that the program
    accepts and ours. A RuntimeError states the violations.
    """
    tables = {path.stem: list(csv.DictReader(path.read_text(encoding="utf-8").splitlines())) for path in (folder / "miappe").glob("*.csv")}
    (above,), (study,) = tables["investigation"], tables["study"]
    parts = {name: [_entity(name, row, index) for index, row in enumerate(tables[name])] for name in FIELDS}
    lists = {f"{name.removesuffix('y')}{'ie' if name.endswith('y') else ''}s": parts[name] for name in list(FIELDS)[1:]}
    ids = {"unique_id": study["Study unique ID"], "investigation_id": study["Investigation unique ID"]}
    whole = {
        "unique_id": above["Investigation unique ID"],
        "title": above["Investigation title"],
        "description": above["Investigation description"],
        "public_release_date": above["Public release date"],
        "license": above["License"],
        "miappe_version": above["MIAPPE version"],
        "contacts": [{key: value for key, value in one.items() if key != "study_id"} for one in parts["person"]],
        "studies": [parts["study"][0] | ids | lists],
    }
    python = install(environment, PACKAGE)
    file = environment / "investigation.json"
    file.write_text(json.dumps(whole), encoding="utf-8")
    for version in ("1.1", "1.2"):
        run(python.parent / "metaseed", "validate", file, "--profile", "miappe", "--version", version)
    rows = sum(map(len, tables.values()))
    assert all(row[name] for table in tables.values() for row in table for name in row if name.endswith("unique ID"))
    return {f"{PACKAGE}, rows": (rows, rows)}


def _entity(name: str, row: dict[str, str], index: int) -> dict[str, str]:
    made = {key: row[column] for column, key in FIELDS[name].items() if row[column]} | {"study_id": row["Study unique ID"]}
    if name == "data_file":
        made["name"] = made["link"]
    if name in ("data_file", "environment", "factor"):
        made["unique_id"] = f"{name}-{index}"
    if name == "person" and row["Person ID"]:
        made["orcid"] = row["Person ID"].removeprefix("orcid.org/")
    if name == "study":
        del made["study_id"]
    return made
