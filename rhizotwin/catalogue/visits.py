"""Planned scans of a time-lapse experiment in the catalogue, which are called visits."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rhizotwin.catalogue.records import State, Visit
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes.errors import UserError


def plan_visits(catalogue: Catalogue, planned: Sequence[tuple[str, str]]) -> list[Visit]:
    """Replace the planned scans that are still due.

    Scans that have begun or were missed are not changed, also if their plant has no planned scan any more.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    planned : sequence of (str, str)
        Name of the plant and planned time (UTC, ISO 8601) of each scan.

    Returns
    -------
    list of Visit
        Scans that are no longer planned, and were removed.

    Raises
    ------
    UserError
        If a scan that has begun or was missed is no longer planned, although other scans of its plant are.
    """
    plants = {plant for plant, _ in planned}
    wanted = set(planned)
    with catalogue.writing():
        others = [one for one in list_visits(catalogue) if (one.plant, one.due_utc) not in wanted]
        dropped = [one for one in others if one.state == "due" or one.plant in plants]
        for one in dropped:
            if one.state != "due":
                raise UserError(
                    f"{catalogue.path}: the scan of plant {one.plant} planned for {one.due_utc} is {one.state}, but not in the schedule; "
                    "restore start, every_h and rounds in [schedule] (if the time zone of the computer has changed, append the "
                    "previous offset to start, such as +01:00), or use a new catalogue and new folders"
                )
            catalogue.connection.execute(
                "DELETE FROM visits WHERE due_utc = ? AND plant = (SELECT id FROM plants WHERE name = ?)", (one.due_utc, one.plant)
            )
        for plant, due_utc in planned:
            catalogue.connection.execute(
                "INSERT INTO visits (plant, due_utc, state) SELECT id, ?, 'due' FROM plants WHERE name = ? ON CONFLICT DO NOTHING",
                (due_utc, plant),
            )
    return dropped


def list_visits(catalogue: Catalogue, *, plant: str | None = None, state: State | None = None) -> list[Visit]:
    """Return the planned scans that match all given criteria.

    They are sorted by planned time. Scans that are planned for the same time are sorted by the order in which they
    were added.
    """
    found = catalogue.rows(
        "SELECT v.*, p.name, s.path FROM visits v JOIN plants p ON p.id = v.plant LEFT JOIN scans s ON s.id = v.scan"
        " WHERE (?1 IS NULL OR p.name = ?1) AND (?2 IS NULL OR v.state = ?2) ORDER BY v.due_utc, v.id",
        (plant, state),
    )
    return [
        Visit(
            plant=row["name"],
            due_utc=row["due_utc"],
            state=row["state"],
            began_utc=row["began_utc"],
            ended_utc=row["ended_utc"],
            scan=None if row["path"] is None else catalogue.full_path(row["path"]),
            note=row["note"],
        )
        for row in found
    ]


def update_visit(catalogue: Catalogue, visit: Visit, *, state: State, at_utc: str, scan: Path | None = None, note: str = "") -> Visit:
    """Change the state of a planned scan.

    Parameters
    ----------
    catalogue : Catalogue
        Open catalogue.
    visit : Visit
        Planned scan from `list_visits`.
    state : State
        New state.
    at_utc : str
        Time of the change, UTC (ISO 8601).
    scan : Path or None
        Folder of the finished dataset, which must be in the catalogue.
    note : str
        Reason for the change, for the user.

    Returns
    -------
    Visit
        Changed entry.

    Raises
    ------
    UserError
        If the dataset is not in the catalogue.
    """
    began = visit.began_utc or (at_utc if state == "scanning" else "")
    ended = at_utc if state in ("scanned", "missed") else ""
    with catalogue.writing():
        number = None if scan is None else catalogue.scan_id(scan)
        catalogue.connection.execute(
            "UPDATE visits SET state = ?, began_utc = ?, ended_utc = ?, scan = ?, note = ?"
            " WHERE due_utc = ? AND plant = (SELECT id FROM plants WHERE name = ?)",
            (state, began, ended, number, note, visit.due_utc, visit.plant),
        )
    return replace(visit, state=state, began_utc=began, ended_utc=ended, scan=scan, note=note)
