"""List the licences of what an installation without extras brings, and refuse copyleft ones.

    python packaging/licences.py            # prints the table of docs/licences.md

It reads the metadata of the environment that it runs in; what `rhizotwin` does not need there is left out.
"""

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

COPYLEFT = re.compile(r"\b(?:A|L)?GPL|General Public Licen[cs]e|CeCILL|EUPL|SSPL|CDDL|EPL", re.IGNORECASE)
BY_FILE = re.compile(r"\bMPL\b|Mozilla Public", re.IGNORECASE)
MAY_BE_BY_FILE = ("certifi", "tqdm")
"""Under the MPL-2.0, which asks for changes of their own files alone; no other package falls under it."""
UNKNOWN = "unknown"


def needed(name: str = "rhizotwin") -> list[Distribution]:
    """Return the installed distributions that one needs without extras, itself first, then by name.

    Raises
    ------
    PackageNotFoundError
        If one is not installed.
    """
    found: dict[str, Distribution] = {}
    waiting = [name]
    while waiting:
        one = distribution(waiting.pop())
        key = one.metadata["Name"].lower().replace("_", "-")
        if key in found:
            continue
        found[key] = one
        for text in one.requires or ():
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                waiting.append(requirement.name)
    first = found.pop(name)
    return [first, *(found[key] for key in sorted(found))]


def licence(one: Distribution) -> str:
    """Return a distribution's licence: its SPDX expression, its classifiers, or the first line of its text."""
    expression = one.metadata.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = [value for key, value in one.metadata.items() if key == "Classifier" and value.startswith("License ::")]
    named = [value.rpartition(" :: ")[2] for value in classifiers if value != "License :: OSI Approved"]
    if named:
        return "; ".join(named)
    text = (one.metadata.get("License") or "").strip()
    return text.splitlines()[0] if text else UNKNOWN


def refused(name: str, text: str) -> bool:
    """Tell whether a licence may not be part of the default installation."""
    if text == UNKNOWN or COPYLEFT.search(text):
        return True
    return bool(BY_FILE.search(text)) and name not in MAY_BE_BY_FILE


def main() -> int:
    """Print the table; the exit code is 1 where a licence is refused."""
    try:
        found = needed()
    except PackageNotFoundError as error:
        sys.stderr.write(f"licences: {error}; install rhizotwin into this environment first\n")
        return 2
    rows = [(one.metadata["Name"], one.version, licence(one)) for one in found]
    sys.stdout.write("| package | version | licence |\n|---|---|---|\n")
    sys.stdout.writelines(f"| {name} | {version} | {text} |\n" for name, version, text in rows)
    bad = [f"{name} ({text})" for name, _, text in rows if refused(name.lower(), text)]
    if bad:
        sys.stderr.write(f"licences: not for the default installation: {', '.join(bad)}\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
