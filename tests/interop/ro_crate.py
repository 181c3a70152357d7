"""Check that roc-validator accepts a published folder; it is installed apart, so that its newest dependencies are met."""

import io
import sys
from pathlib import Path
from unittest import mock

PACKAGES = ("roc-validator==0.13.0", "rocrate==0.16.0")
PROFILE = "ro-crate-1.1"


def check(folder: Path, environment: Path) -> dict[str, tuple[float, float]]:
    """Validate a folder that ``rhizotwin export --publish`` wrote, recommended properties included.

    The program is installed into the folder ``environment``. The result contains the number of violations by the
    program and ours. An AssertionError states the violations.
    """
    from tests.interop.environment import install, run  # the program's environment runs this file without it

    told = run(install(environment, *PACKAGES), __file__, folder)
    assert told.splitlines()[-1:] == ["valid"], told
    return {f"{PACKAGES[0]}, violations": (0, 0)}


def violations(folder: Path, severity: str = "RECOMMENDED") -> list[str]:
    """Return the violations that the installed roc-validator finds. RO-Crate's context is read from the package rocrate."""
    import requests
    import rocrate
    from rocrate_validator import models, services
    from rocrate_validator.utils import http

    packaged = (Path(rocrate.__file__).parent / "data" / "ro-crate.jsonld").read_bytes()

    def get(_: object, url: str, **__: object) -> requests.Response:
        assert url.startswith("https://w3id.org/ro/crate/"), url
        response = requests.Response()
        response.status_code, response.url, response.raw = 200, url, io.BytesIO(packaged)
        response.headers["Content-Type"] = "application/ld+json"
        return response

    wanted = {"profile_identifier": PROFILE, "requirement_severity": models.Severity[severity]}
    with mock.patch.object(http.HttpRequester, "get", get, create=True):
        found = services.validate(services.ValidationSettings(rocrate_uri=str(folder), **wanted))
    return [str(issue.message) for issue in found.get_issues()]


if __name__ == "__main__":
    sys.stdout.write("\n".join(violations(Path(sys.argv[1])) or ["valid"]) + "\n")
