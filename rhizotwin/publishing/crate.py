"""Write the metadata of a publication as RO-Crate (Soiland-Reyes et al. 2022, Data Science 5:97)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rhizotwin.publishing.miappe import subjects
from rhizotwin.publishing.published import Found, Scan
from rhizotwin.publishing.study import LICENCES, Study
from rhizotwin.scenes.errors import UserError, pip_install

_TYPES = {".csv": "text/csv", ".md": "text/markdown", ".txt": "text/plain", ".png": "image/png"}


def write(folder: Path, study: Study, scans: Sequence[Scan], results: Sequence[Found], *, files: dict[str, str], version: str) -> None:
    """Write ``ro-crate-metadata.json`` to a folder.

    Parameters
    ----------
    folder : Path
        Folder to publish.
    study : Study
        Description of the data.
    scans, results : sequence of Scan, sequence of Found
        Scans and results in the folder.
    files : dict of str
        Descriptions of the files at the top level of the folder, by file name.
    version : str
        Version of this program.

    Raises
    ------
    UserError
        If rocrate is not installed.
    """
    try:
        from rocrate.rocrate import ROCrate
    except ModuleNotFoundError:
        raise UserError(f"publishing needs the package rocrate; install it with: {pip_install('rocrate')}") from None
    crate = ROCrate(version="1.1")  # the version that most repositories read
    crate.name, crate.description, crate.keywords = study.title, study.description, list(study.keywords)
    crate.datePublished = study.published
    licence = {"@id": study.licence_url, "@type": "CreativeWork", "name": LICENCES[study.licence], "description": f"SPDX: {study.licence}"}
    crate.license = crate.add_jsonld({**licence, "url": study.licence_url})
    homes = {str(entity["name"]): crate.add_jsonld(entity) for entity in _institutions(study)}
    people = [crate.add_jsonld(entity) for entity in _people(study)]
    for person, author in zip(people, study.authors, strict=True):
        if author.affiliation:
            person["affiliation"] = homes[author.affiliation]
    crate.root_dataset["author"] = people if len(people) > 1 else people[0]
    if homes:
        crate.root_dataset["publisher"] = next(iter(homes.values()))
    if study.publication_doi:
        doi = study.publication_doi
        paper = {"@id": f"https://doi.org/{doi}", "@type": "ScholarlyArticle", "name": f"doi:{doi}"}
        crate.root_dataset["citation"] = crate.add_jsonld(paper)
    for name, description in files.items():
        about = {"name": name, "description": description, "encodingFormat": _TYPES[Path(name).suffix]}
        crate.add_file(dest_path=name, properties={**about, "contentSize": str((folder / name).stat().st_size)})
    entities = {scan.name: crate.add_dataset(dest_path=scan.place, properties=_scan(scan)) for scan in scans}
    program = {"@id": "#rhizotwin", "@type": "SoftwareApplication", "name": "rhizotwin", "version": version}
    software = crate.add_jsonld(program)
    for found in results:
        result = crate.add_dataset(dest_path=found.place, properties=_result(found))
        plain: dict[str, Any] = {"@id": f"#reconstruct-{found.name}", "@type": "CreateAction", "name": f"Reconstruction of {found.name}"}
        action = crate.add_jsonld({**plain, "description": f"rhizotwin {found.version or 'of unknown version'}"})
        action["instrument"], action["result"] = software, result
        if found.scan is not None:
            action["object"] = entities[found.scan.name]
    crate.metadata.write(folder)


def _institutions(study: Study) -> list[dict[str, Any]]:
    """Return the institutions as RO-Crate entities, starting with the study's institution."""
    addresses = {study.institution: ""} | {one.affiliation: one.affiliation_url for one in study.authors}
    named = ((name, address) for name, address in addresses.items() if name)
    return [
        {"@id": address or f"#organization-{number}", "@type": "Organization", "name": name, **({"url": address} if address else {})}
        for number, (name, address) in enumerate(named, start=1)
    ]


def _people(study: Study) -> list[dict[str, Any]]:
    """Return the authors as RO-Crate entities."""
    found = []
    for number, one in enumerate(study.authors, start=1):
        identity = f"https://orcid.org/{one.orcid}" if one.orcid else f"#author-{number}"
        found.append({"@id": identity, "@type": "Person", "name": one.name, **({"email": one.email} if one.email else {})})
    return found


def _scan(scan: Scan) -> dict[str, Any]:
    plants = "; ".join(filter(None, (str(one) for one in subjects(scan)))) or scan.dataset.scene.name
    made = "simulated" if scan.simulated else "camera"
    return {"name": f"Scan {scan.name}", "description": f"{len(scan.dataset.frames)} {made} pictures around the canister: {plants}"}


def _result(found: Found) -> dict[str, Any]:
    trusted = "reliable" if found.summary["volume_trusted"] else "not reliable"
    volume = f"volume {float(found.summary['volume_mm3']) / 1000.0:.4g} ml ({trusted})"
    return {"name": f"Reconstruction {found.name}", "description": f"Shape, roots and traits; {volume}"}
