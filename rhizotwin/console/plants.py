"""Plants in the catalogue of the console, with functions that identify them and list their scans."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date, datetime
from pathlib import Path
from typing import Any

from rhizotwin.catalogue import adding
from rhizotwin.catalogue.identity import WrongPlantError, check_plant, identify
from rhizotwin.catalogue.records import Plant, Visit
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.visits import list_visits
from rhizotwin.scenes.model import MarkerStrip, Scene
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.subject import Subject
from rhizotwin.steps import rigs

MOST_SHOWN = 6
"""Maximum number of future scans in the list, and of missed scans. Scans planned for today are always listed."""

BUSY_S = 1.0
"""Maximum time to wait for access to the catalogue if its plants are displayed, s. The state then contains the plants
that were read last."""


class Plants:
    """Provides the plants, scans and planned scans of a catalogue to the console.

    Parameters
    ----------
    path : path
        Catalogue file, which is created if it does not exist.

    Raises
    ------
    UserError
        If the file is not a catalogue.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with Catalogue.open_or_create(path):
            pass
        self._stamp: Any = None
        self._plain: tuple[list[dict[str, object]], dict[str, Any]] = NOTHING

    def scene_of(self, scene: Scene) -> Scene:
        """Return a copy of a scan's scene, completed with the catalogue's data about the plant.

        Raises
        ------
        UserError
            If a value in the scene differs from the catalogue.
        """
        plant = self._plant(scene.subject.plant)
        return scene if plant is None else rigs.scene_of_plant(scene, plant)

    def identity(self, subject: Subject, strip: MarkerStrip) -> Callable[[Grey], object]:
        """Return a function that checks the identity of the plant in the first picture of a scan.

        If the catalogue has the marker strip of the plant, the picture must show this strip. Otherwise the picture must
        not show the strip of any plant in the catalogue.

        Parameters
        ----------
        subject : Subject
            Plant to be scanned.
        strip : MarkerStrip
            Marker strip of the scan's scene.
        """
        with Catalogue.open(self.path, read_only=True) as catalogue:
            plants = catalogue.plants()
        expected = next((plant for plant in plants if plant.name == subject.plant), None)
        if expected is not None and expected.tag is not None:
            return check_plant(expected, plants, strip)
        if not any(plant.tag is not None for plant in plants):
            return lambda _: None

        def check(image: Grey) -> None:
            try:
                found = identify(image, plants, strip)
            except WrongPlantError:
                return
            raise WrongPlantError(
                f"the plant on the turntable is {found.name} instead of {subject.plant or 'a plant without a name'}; "
                f"put the right canister on the turntable, or start a scan of {found.name}",
                found=found.name,
            )

        return check

    def add_scan(self, folder: Path) -> None:
        """Add a scan to the catalogue, or update its entry."""
        with Catalogue.open(self.path) as catalogue:
            adding.add_scan(catalogue, folder)

    def add_result(self, folder: Path) -> None:
        """Add a result to the catalogue, or update its entry."""
        with Catalogue.open(self.path) as catalogue:
            adding.add_result(catalogue, folder)

    def add_unlisted(self, scans: Path, results: Path) -> list[str]:
        """Add scans and results that are not in the catalogue, or have changed since they were added.

        A console that was killed after a scan leaves such scans.

        Parameters
        ----------
        scans, results : path
            Folders of the scans and of the results.

        Returns
        -------
        list of str
            Message for each scan and result that could not be added.
        """
        with Catalogue.open(self.path) as catalogue:
            return list(adding.add_all(catalogue, adding.find_unlisted(catalogue, scans, results)).failed)

    def plain(self) -> tuple[list[dict[str, object]], dict[str, Any]]:
        """Return the plants and the planned scans as JSON values."""
        today = datetime.now().astimezone().date()
        stamp = (today, *(_stamp(self.path.with_name(f"{self.path.name}{end}")) for end in ("", "-wal")))
        if stamp != self._stamp:
            with Catalogue.open(self.path, read_only=True, busy_s=BUSY_S) as catalogue:
                self._plain = _plants(catalogue, today), _visits(list_visits(catalogue), today)
            self._stamp = stamp
        return self._plain

    def _plant(self, name: str) -> Plant | None:
        with Catalogue.open(self.path, read_only=True) as catalogue:
            return next((plant for plant in catalogue.plants() if plant.name == name), None)


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _plants(catalogue: Catalogue, today: date) -> list[dict[str, object]]:
    scans = catalogue.scans()
    found: list[dict[str, object]] = []
    for plant in catalogue.plants():
        own = [scan for scan in scans if plant.name in scan.plants]
        day = (today - date.fromisoformat(plant.sown)).days if plant.sown else None
        last = max((scan.date for scan in own), default="")
        tag = "" if plant.tag is None else str(plant.tag)
        found.append({"name": plant.name, "treatment": plant.treatment, "tag": tag, "day": day, "scans": len(own), "last": last})
    return found


def _visits(visits: list[Visit], today: date) -> dict[str, Any]:
    """Return the scans planned for today, the next planned scans, and the missed scans, as JSON values."""
    open_ = [visit for visit in visits if visit.state in ("due", "scanning")]
    todays = [visit for visit in visits if _local(visit).date() == today]
    following = [visit for visit in open_ if visit not in todays][:MOST_SHOWN]
    missed = [visit for visit in visits if visit.state == "missed" and visit not in todays]
    return {
        "planned": len(visits),
        "scanned": sum(visit.state == "scanned" for visit in visits),
        "missed_count": sum(visit.state == "missed" for visit in visits),
        "today": [_visit(visit) for visit in todays],
        "next": [_visit(visit) for visit in following],
        "missed": [_visit(visit) for visit in missed[-MOST_SHOWN:]],
    }


def _local(visit: Visit) -> datetime:
    return datetime.fromisoformat(visit.due_utc).astimezone()


def _visit(visit: Visit) -> dict[str, str]:
    return {"plant": visit.plant, "due": f"{_local(visit):%Y-%m-%d %H:%M}", "state": visit.state, "note": visit.note}


NOTHING: tuple[list[dict[str, object]], dict[str, Any]] = [], _visits([], date.min)
"""Plants and planned scans of an empty catalogue."""
