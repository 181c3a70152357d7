"""Description of published data: title, authors, licence and location."""

import re
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Literal

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.schema import Place, from_plain

LICENCES = {
    "CC0-1.0": "Creative Commons Zero v1.0 Universal",
    "CC-BY-4.0": "Creative Commons Attribution 4.0 International",
    "CC-BY-SA-4.0": "Creative Commons Attribution Share Alike 4.0 International",
    "CC-BY-NC-4.0": "Creative Commons Attribution Non Commercial 4.0 International",
    "CC-BY-NC-SA-4.0": "Creative Commons Attribution Non Commercial Share Alike 4.0 International",
    "ODC-By-1.0": "Open Data Commons Attribution License v1.0",
    "ODbL-1.0": "Open Data Commons Open Database License v1.0",
    "PDDL-1.0": "Open Data Commons Public Domain Dedication & License 1.0",
}
"""Names of data licences by SPDX identifier."""
EXAMPLE = """title = "Roots of radishes in nutrient solution"
description = "Eighteen radishes, scanned every five days."
licence = "CC-BY-4.0"

[[authors]]
name = "Ada Example"
orcid = "0000-0002-1825-0097"
affiliation = "University of Example"
affiliation_url = "https://university.example"
"""
"""Minimum contents of a study file."""
_ORCID = re.compile(r"\d{4}-\d{4}-\d{4}-\d{3}[\dX]", re.ASCII)
_URL = re.compile(r"https?://[^\s\"<>]+", re.ASCII)
_DOI = re.compile(r"10\.\d{4,9}/\S+", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Author:
    """Author of the published data."""

    name: str
    """Given name and family name."""
    orcid: str = ""
    """ORCID iD, such as 0000-0002-1825-0097."""
    affiliation: str = ""
    """Institution of the author."""
    affiliation_url: str = ""
    """Web address of the institution, preferably from https://ror.org."""
    email: str = ""
    """Email address, which is published."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Contents of a study file (TOML)."""

    title: str
    """Title of the data (MIAPPE: study title)."""
    description: str
    """Purpose and procedure in a few sentences (MIAPPE: study description)."""
    licence: Literal["CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "CC-BY-NC-SA-4.0", "ODC-By-1.0", "ODbL-1.0", "PDDL-1.0"]
    """SPDX identifier of the licence."""
    authors: tuple[Author, ...]
    """Authors in the order of citation."""
    keywords: tuple[str, ...] = ("plant roots", "phenotyping", "hydroponics")
    """Search keywords."""
    published: str = ""
    """Date of publication, such as 2026-11-25. If it is empty, the current date is used."""
    publication_doi: str = ""
    """DOI of the paper about the data, such as 10.1234/abc."""
    identifier: str = ""
    """Identifier of the data without spaces, such as a reserved DOI (MIAPPE: investigation unique ID). If it is empty,
    an identifier is computed from the data."""
    start: str = ""
    """Date on which the experiment started (MIAPPE: start date of study). If it is empty, it is the date of the first
    scan."""
    end: str = ""
    """Date on which the experiment ended (MIAPPE: end date of study)."""
    institution: str = ""
    """Institution at which the plants were grown (MIAPPE: contact institution). If it is empty, it is the affiliation
    of the first author that has one."""
    site: str = ""
    """Name of the greenhouse or laboratory (MIAPPE: experimental site name). If it is empty, it is the institution."""
    design: str = ""
    """Design of the experiment (MIAPPE: description of the experimental design). If it is empty, numbers of plants,
    treatments and days are stated."""
    country: str = ""
    """Country of the institution, as ISO 3166 code or name (MIAPPE: geographic location, country)."""
    facility: str = "growth chamber"
    """Growth facility (MIAPPE: description of growth facility)."""
    cultivation: str = "single plants in round acrylic canisters of nutrient solution"
    """Cultivation of the plants (MIAPPE: cultural practices)."""

    @property
    def licence_url(self) -> str:
        """Web address of the licence text."""
        return f"https://spdx.org/licenses/{self.licence}"


def read_study(path: Path) -> Study:
    """Read and validate a study file.

    Raises
    ------
    UserError
        If the file cannot be read, a key is unknown or missing, there is no author, an ORCID iD has a wrong check
        digit, a date or DOI is invalid, or a text contains line breaks.
    """
    table, text = read_toml(path)
    place = Place(str(path), text)
    study = from_plain(Study, table, place)
    if not study.authors:
        raise place.at("authors").error("must contain at least one author")
    if not study.title.strip():
        raise place.at("title").error("must not be empty", study.title)
    for number, author in enumerate(study.authors):
        here = place.at("authors", number)
        if not author.name.strip() or not author.name.isprintable():
            raise here.at("name").error("must be a name on one line", ascii(author.name))
        if author.affiliation_url and not _URL.fullmatch(author.affiliation_url):
            raise here.at("affiliation_url").error("must be a web address such as https://ror.org/01zkghx44", author.affiliation_url)
        if author.orcid and not _is_orcid(author.orcid):
            raise here.at("orcid").error("must be an ORCID iD with a valid check digit, such as 0000-0002-1825-0097", author.orcid)
    if study.identifier != "".join(study.identifier.split()):
        raise place.at("identifier").error("must not contain spaces", study.identifier)
    for key in ("published", "start", "end"):
        _check_date(getattr(study, key), place.at(key))
    if study.publication_doi and not _DOI.fullmatch(study.publication_doi):
        raise place.at("publication_doi").error("must be a DOI without https://doi.org/, such as 10.1234/abc", study.publication_doi)
    return study


def _check_date(text: str, place: Place) -> None:
    try:
        date.fromisoformat(text or "2000-01-01")
    except ValueError:
        raise place.error("must be a date such as 2026-11-25", text) from None


def _is_orcid(text: str) -> bool:
    """Return whether a text is an ORCID iD with a valid check digit (ISO 7064, MOD 11-2)."""
    if not _ORCID.fullmatch(text):
        return False
    total = 0
    for digit in text.replace("-", "")[:-1]:
        total = 2 * (total + int(digit))
    rest = (12 - total % 11) % 11
    return text[-1] == ("X" if rest == 10 else str(rest))


def missing_study(folder: Path) -> UserError:
    """Return a UserError about a missing study file, with an example of its contents."""
    lines = " | ".join(line for line in EXAMPLE.splitlines() if line)
    return UserError(
        f"{folder} cannot be published without a description of the data; specify --study "
        f"FILE.toml, for example with: {lines} (see docs/publishing.md)"
    )
