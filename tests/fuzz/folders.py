"""Folders as somebody hostile would send them, given to every command that takes a folder: ./run fuzz --folders.

A command may succeed or say a sentence. It must leave everything outside the folder unread and unchanged, a command that only
reads must leave the folder itself as it is, and no control code may reach the terminal.
"""

import hashlib
import json
import os
import shutil
import stat
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.process import Ended, load, run

CORPUS = Path(__file__).parent / "corpus"
STEER = "\x1b[2J\x1b]0;owned\x07\x9b2J"
MARKS = (".rhizotwin-lock", ".rhizotwin-new", ".rhizotwin-old", ".rhizotwin-whole", ".rhizotwin-moving", ".rhizotwin-jobs")
ENTRIES = (
    *("result.json", "dataset.json", "shape.ply", "shape.npz", "roots.rsml", "traits.csv", "traits.json", "report.html", "edits.json"),
    *("score.json", "overview.html", "silhouettes", "silhouettes/view_0.png", "seen", "pictures", "pictures/shape.png", "images"),
    *("images/view_0.png", "truth", "truth/truth.json", "truth/simulate.json", "truth/specimen.ply", "truth/shots.jsonl", "scores"),
    *("stages", "plan.csv", "jobs", "unfinished", "dataset", "result", "view_0.png", "board.toml", ".rhizotwin-jobs/dataset.json"),
)
NAMES = (b"\x1b[2J", b"a\nb", b"\xff\xfe", b"n" * 255, b"-o", b"'\"$(x)`", "\u202etxt".encode(), b"%s%n", b"[*]?", b" ", b"\x9b2J", b"...")
LOCKS = (
    *(b"", b"\x00" * 5000, b"[" * 100_000, b"\xff\xfe", b'{"pid": 1}', b'{"pid": 1e999, "host": [], "since": {}}', b"9" * 5000),
    json.dumps({"pid": STEER, "host": STEER * 1000, "since": STEER}).encode(),
)

Change = Callable[[Path, Path], None]
"""What is done to a folder; the second path is what it must not lead to."""


def shapes() -> dict[str, Change]:
    """Return what may stand at any name instead of what belongs there."""

    def many(at: Path, _: Path) -> None:
        at.mkdir()
        for name in ("result.json", "dataset.json", "images/view_0.png", "thesis.txt"):
            put(at / name, b"{}")

    def listing(names: list[str]) -> Change:
        return lambda at, _: put(at / ".rhizotwin-replaced.json", json.dumps(names).encode())

    def nested(at: Path, outside: Path) -> None:
        many(at, outside)
        (at / "docs").symlink_to(outside / "docs")
        (at / "thesis").symlink_to(outside / "thesis.txt")

    return {
        "link to a folder": lambda at, outside: at.symlink_to(outside / "docs"),
        "link to a file": lambda at, outside: at.symlink_to(outside / "thesis.txt"),
        "relative link": lambda at, outside: at.symlink_to(os.path.relpath(outside / "thesis.txt", at.parent)),
        "link to nothing": lambda at, outside: at.symlink_to(outside / "nothing"),
        "loop": lambda at, _: at.symlink_to(at.name),
        "pipe": lambda at, _: os.mkfifo(at),
        "device": lambda at, _: at.symlink_to("/dev/zero"),
        "other link": lambda at, outside: os.link(outside / "thesis.txt", at),
        "file": lambda at, _: put(at, STEER.encode()),
        "files": many,
        "files of paths": listing(["/etc/hostname", "../outside/thesis.txt", STEER]),
        "links in it": nested,
        "deep folders": lambda at, _: (at / "/".join("d" * 300)).mkdir(parents=True),
    }


def variants() -> dict[str, Change]:
    """Return what is done to a folder, by name."""
    found: dict[str, Change] = {}
    for mark, (shape, make) in product(MARKS, shapes().items()):
        found[f"{mark}: {shape}"] = lambda folder, outside, mark=mark, make=make: make(cleared(folder / mark), outside)
    for entry, (shape, make) in product(ENTRIES, shapes().items()):
        if shape in ("link to a folder", "link to a file", "pipe", "device"):
            found[f"{entry}: {shape}"] = lambda folder, outside, entry=entry, make=make: make(cleared(folder / entry), outside)
    for mark in MARKS[1:5]:

        def through(folder: Path, outside: Path, mark: str = mark) -> None:
            cleared(folder / "images").symlink_to(outside / "docs")
            put(folder / mark / "images" / "evil.txt", b"evil")

        found[f"{mark}: into a linked folder"] = through
    for number, text in enumerate(LOCKS):
        found[f"lock: text {number}"] = lambda folder, _, text=text: put(folder / MARKS[0], text)

        def half(folder: Path, _: Path, text: bytes = text) -> None:
            put(folder / MARKS[0], text)
            put(folder / MARKS[3] / "a", b"x")
            for head in ("dataset.json", "result.json"):
                (folder / head).unlink(missing_ok=True)

        found[f"lock: text {number}, half moved"] = half
    for shape, name in product(("link to a file", "link to a folder", "pipe", "files"), ("result.json", "report.html")):

        def left(folder: Path, outside: Path, name: str = name, shape: str = shape) -> None:
            put(folder / MARKS[0], b"{}")
            shapes()[shape](folder / f".{name}.12-abcdef01.tmp", outside)

        found[f"left of {name}: {shape}"] = left
    for number, name in enumerate(NAMES):
        found[f"file name {number}"] = lambda folder, _, name=name: put(folder / os.fsdecode(name), b"x")
    for key in ("scene", "dataset", "volume_verdict", "warnings", "subject"):
        found[f"result.json: {key}"] = lambda folder, _, key=key: texts(folder / "result.json", key)
    for key in ("file", "origin", "name"):
        found[f"dataset.json: {key}"] = lambda folder, _, key=key: texts(folder / "dataset.json", key)
    return found


def put(at: Path, data: bytes) -> None:
    """Write a file and the folders that it needs."""
    at.parent.mkdir(parents=True, exist_ok=True)
    at.write_bytes(data)


def cleared(at: Path) -> Path:
    """Return a path at which nothing is any more, in a folder that is there."""
    at.parent.mkdir(parents=True, exist_ok=True)
    if at.is_dir() and not at.is_symlink():
        shutil.rmtree(at)
    else:
        at.unlink(missing_ok=True)
    return at


def texts(file: Path, key: str) -> None:
    """Put text that steers terminals, or leads out of a folder, at a key of a JSON file."""
    if file.is_file():
        content = json.loads(file.read_text())
        if key == "file":
            content["frames"][0]["file"] = "../../outside/docs/picture.png"
        elif key == "name":
            content["scene"]["name"] = STEER
        else:
            content[key] = {"warnings": [STEER], "subject": {"plant": STEER}, "origin": {"program": STEER}}.get(key, STEER)
        file.write_text(json.dumps(content))


@dataclass(frozen=True)
class Given:
    """A command line that takes the foreign folder."""

    words: str
    base: str = ""
    """What the folder holds before it is changed: all, a result, or nothing."""
    writes: bool = False
    """Whether the folder is what the command writes."""


READING = (
    *("traits {f}", "traits {f} -o {out}/t.csv", "report {f} -o {out}/p.html", "export {f} -o {out}/x.stl", "export {f} -o {out}/x.nrrd"),
    *("export {f} -o {out}/x.rsml", "export {f} -o {out}/x.csv", "export {f} --dataset {d} -o {out}/c.json", "growth {f} -o {out}/g"),
    *("export {r} --dataset {f} -o {out}/colmap", "score {f} --volume-ml 1", "score {r} {f}", "score {r} --pictures {f}", "view {f}"),
    *("biomass fit {f} {masses} -o {out}/m.json", "edit {f} --apply {log} -o {out}/e", "view {r} {f}"),
    *("edit {r} --apply {log} --dataset {f} -o {out}/e", "reconstruct {f} -o {out}/r"),
    *("batch {f} -o {out}/b", "import {f} --scene {scene} -o {out}/i"),
    *("calibrate camera {f} --squares 7x5 --square-mm 30 -o {out}/l", "calibrate transfer {f} -o {out}/t.toml"),
)
COMMANDS = (
    *(Given(words, base="all") for words in READING),
    Given("report {f}", base="result", writes=True),
    Given("view {f}", base="result", writes=True),
    Given("reconstruct {d} -o {f}", base="result", writes=True),
    Given("edit {r} --apply {log} -o {f}", base="result", writes=True),
    Given("batch {d} -o {f}", base="all", writes=True),
    *(
        Given(words, writes=True)
        for words in (
            *("reconstruct {d} -o {f}", "import {d}/images --scene {scene} -o {f}", "export {r} --dataset {d} -o {f}", "demo -o {f}"),
            *("simulate {scene} --views 2 --image-wh 32x24 -o {f}", "scan --rig twin --scene {scene} --fidelity sketch --resume -o {f}"),
            *("plan {scene} --views 2 --heights=-42 --image-wh 32x24 -o {f}", "batch simulate {scene} --views 2 -o {f}"),
            *("parts {scene} --part canister_ring -o {f}", "growth {growth} -o {f}", "biomass tables -o {f}"),
        )
    ),
)


def prepared(given: Given, change: Change, place: Path, *, name: bytes = b"foreign") -> list[str]:
    """Make the folder and what lies outside; return the command line."""
    outside, folder = place / "outside", place / "here" / os.fsdecode(name)
    for path in (outside / "docs", place / "out", place / "here"):
        path.mkdir(parents=True)
    put(outside / "thesis.txt", b"years of work")
    shutil.copy(CORPUS / "dataset" / "images" / "view_1.png", outside / "docs" / "picture.png")
    shutil.copy(CORPUS / "result" / "shape.ply", outside / "docs" / "shape.ply")
    for source in ("dataset", "result"):
        shutil.copytree(CORPUS / source, outside / source)
    shutil.copy(CORPUS / "scene.toml", outside / "scene.toml")
    put(outside / "masses.csv", b"plant,mass (g)\na,1.0\n")
    put(outside / "growth.csv", b"result,plant,day,total_length (mm)\nx,a,1,10\ny,a,2,20\n")
    shape = hashlib.sha256((CORPUS / "result" / "shape.npz").read_bytes()).hexdigest()
    log = json.dumps({"schema_version": 1, "shape_sha256": shape, "edits": []}).encode()
    put(outside / "log.json", log)
    folder.mkdir()
    if given.base in ("all", "result"):
        shutil.copytree(CORPUS / "result", folder, dirs_exist_ok=True)
        put(folder / "edits.json", log)
    if given.base == "all":
        shutil.copytree(CORPUS / "dataset", folder, dirs_exist_ok=True)
        shutil.copytree(CORPUS / "dataset" / "images", folder, dirs_exist_ok=True)
    change(folder, outside)
    places = {"f": folder, "out": place / "out", "d": outside / "dataset", "r": outside / "result", "log": outside / "log.json"}
    places |= {"scene": outside / "scene.toml", "masses": outside / "masses.csv", "growth": outside / "growth.csv"}
    return [word.format(**places) for word in given.words.split()]


def snapshot(top: Path) -> dict[str, Any]:
    """Return everything below a folder: kind, inode, times, and bytes or goal."""
    found: dict[str, Any] = {}
    for parent, folders, files in os.walk(top):
        for path in (Path(parent, name) for name in ["", *folders, *files]):
            status = path.lstat()
            content: Any = path.readlink() if path.is_symlink() else path.read_bytes() if stat.S_ISREG(status.st_mode) else None
            found[str(path)] = (status.st_mode, status.st_ino, status.st_mtime_ns, status.st_nlink, content)
    return found


def tried(given: Given, change: Change, place: Path, *, name: bytes = b"foreign") -> str:
    """Run a command on a folder; return what must not be, empty where all is well."""
    words = prepared(given, change, place, name=name)
    top = place / "outside" if given.writes else place
    for quiet in ("stdout", "stderr", "opened"):
        (place / quiet).touch()
    os.utime(place / "out", ns=(0, 0))
    before = {path: what for path, what in snapshot(top).items() if not _is_ours(path, place)}
    ended: Ended = run(words, place, before=lambda: _watched(place, save=given.writes))
    after = {path: what for path, what in snapshot(top).items() if not _is_ours(path, place)}
    changed = sorted(path for path in before.keys() | after.keys() if before.get(path) != after.get(path))
    printed = ((place / "stdout").read_bytes() + (place / "stderr").read_bytes()).decode(errors="replace")
    if changed:
        return f"changed {changed[0]}"
    if opened := (place / "opened").read_text():
        return f"opened {opened.splitlines()[0]}"
    if any(code in printed for code in "\x1b\x07\x9b\u202e"):
        return "control codes on the terminal"
    return f"{ended.wrong}: {ended.said[-300:]}" if ended.wrong not in ("", "strange lines") else ""


def _is_ours(path: str, place: Path) -> bool:
    return path.removeprefix(f"{place}/").partition("/")[0] in (".", "out", "stdout", "stderr", "opened")


def _watched(place: Path, *, save: bool) -> None:
    """Note what the child opens outside the folder, and stand in for what needs an engine, a browser or other processes."""
    secret = [os.path.realpath(place / "outside" / name) for name in ("docs", "thesis.txt")]
    notes = os.open(place / "opened", os.O_WRONLY | os.O_APPEND)

    def hear(event: str, given: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir", "os.truncate") and isinstance(given[0], str | bytes | os.PathLike):
            if event == "open" and len(given) > 2 and given[2] and given[2] & (os.O_NOFOLLOW | os.O_EXCL):
                return
            real = os.path.realpath(os.fsdecode(given[0]))
            if any(real == one or real.startswith(f"{one}/") for one in secret):
                os.write(notes, f"{event} {os.fsdecode(given[0])!a}\n".encode())

    sys.addaudithook(hear)
    stand_ins(save=save)


def stand_ins(*, save: bool) -> None:
    """Let commands in this process do without an engine, a browser and other processes."""
    import rhizotwin.batches.local
    import rhizotwin.commands.view
    import rhizotwin.recon.reconstruct
    import rhizotwin.sim.simulate
    import rhizotwin.steps.demo
    from rhizotwin.batches.jobs import Outcome
    from rhizotwin.batches.work import work
    from rhizotwin.report import result_pictures
    from rhizotwin.scenes.dataset import load_dataset, read_image
    from rhizotwin.stored.load import load_result
    from rhizotwin.viewer import app, guard
    from rhizotwin.viewer.shown import Shown

    def reconstruct(dataset: Any, **_: Any) -> Any:
        dataset = load_dataset(dataset) if isinstance(dataset, str | Path) else dataset
        for frame in dataset.frames:
            read_image(dataset, frame)
        return load_result(CORPUS / "result")

    class Renderer:
        def __init__(self, scene: Any, *_: Any, **__: Any) -> None:
            width, height = scene.camera.image_wh
            self.picture = np.full((height, width), 0.5, np.float32)

        def view(self, _: int) -> Any:
            return self.picture, self.picture

    def show(_: Any, folders: Any, dataset: Any) -> Any:
        for folder in folders:
            shown = Shown(folder, dataset)
            assert shown.session is not None
            _ = shown.dataset, shown.truth, shown.surface_now()
            if save:
                shown.session.save()
        raise SystemExit(0)

    rhizotwin.recon.reconstruct.reconstruct = reconstruct
    rhizotwin.sim.simulate.Renderer = Renderer
    rhizotwin.steps.demo.FULL = replace(rhizotwin.steps.demo.FULL, views=2, image_wh=(32, 24))
    rhizotwin.batches.local.run = lambda jobs, **_: ((job, Outcome(**work(job.plain()))) for job in jobs)
    result_pictures.write_pictures = lambda *_, **__: []
    guard.serve = lambda **_: type("Served", (), {"address": "", "port": 0})()
    app.show = show


def campaign(most: int) -> int:
    """Try at most so many pairs of variant and command, evenly chosen, print what was found; return 1 where anything was."""
    load()
    finds: Counter[str] = Counter()
    done, pairs = 0, list(_all())
    for name, change, given, called in pairs[:: max(1, len(pairs) // most)]:
        with tempfile.TemporaryDirectory(prefix="rhizotwin-folders-") as place:
            found = tried(given, change, Path(place), name=called)
        done += 1
        if found:
            finds[found.split(" ")[0]] += 1
            sys.stdout.write(f"{given.words}, {name}: {found}\n")
            sys.stdout.flush()
    counts = {"variants": len(variants()) + len(NAMES), "commands": len(COMMANDS), "runs": done, "finds": dict(finds)}
    sys.stdout.write(f"{json.dumps(counts)}\n")
    return 1 if finds or not done else 0


def _all() -> Iterator[tuple[str, Change, Given, bytes]]:
    for name, change in variants().items():
        yield from ((name, change, given, b"foreign") for given in COMMANDS)
    for number, called in enumerate(NAMES):
        yield from ((f"folder name {number}", lambda *_: None, given, called) for given in COMMANDS)
