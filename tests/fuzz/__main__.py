"""Give damaged files to the commands, each in a process of its own, and count how they end: ./run fuzz --minutes 10.

A command may succeed (0) or say in one sentence what to put right (2). Anything else is a find: exit 1 or a signal, a traceback, an
"unexpected error", libraries' own lines on stderr, more time or memory than a small file can need. Finds are kept with their seed.
"""

import argparse
import collections
import json
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from rhizotwin.commands import command_line
from tests.fuzz import folders
from tests.fuzz.mutate import STRANGE, mutated
from tests.fuzz.process import load, run

CORPUS = Path(__file__).parent / "corpus"
SIMULATE = ("simulate", "{corpus}/scene.toml", "--views", "1", "--image-wh", "32x24", "-o", "{out}/simulated")
CHEAP = ("--part", "canister_ring")
"""The part whose drawing takes least: all of them take 45 s."""
COMMANDS: dict[str, tuple[str, ...]] = {  # by the file that is damaged, its last word
    "scene.toml": ("scenes", "{file}", "-o", "{out}/copy.toml"),
    "rig.toml": ("rig", "check", "{file}"),
    "parts of scene.toml": ("parts", "{file}", "--rig", "{corpus}/rig.toml", *CHEAP, "-o", "{out}/parts"),
    "parts of rig.toml": ("parts", "{corpus}/scene.toml", "--rig", "{file}", *CHEAP, "-o", "{out}/parts"),
    "parts of measures.toml": ("parts", "{corpus}/scene.toml", "--measures", "{file}", *CHEAP, "-o", "{out}/parts"),
    "transforms.json": ("import", "{corpus}/dataset/images", "--scene", "{corpus}/scene.toml", "--cameras", "{file}", "-o", "{out}/set"),
    "dataset/dataset.json": ("export", "{corpus}/result", "--dataset", "{corpus}/dataset", "-o", "{out}/cameras.json"),
    "result/result.json": ("export", "{corpus}/result", "--dataset", "{corpus}/dataset", "-o", "{out}/cameras.json"),
    "traits of result/result.json": ("traits", "{corpus}/result", "-o", "{out}/traits.csv"),
    "report of result/result.json": ("report", "{corpus}/result", "-o", "{out}/report.html"),
    "result/shape.ply": ("export", "{corpus}/result", "-o", "{out}/root.stl"),
    "result/shape.npz": ("export", "{corpus}/result", "-o", "{out}/root.nrrd"),
    "result/roots.rsml": ("export", "{corpus}/result", "-o", "{out}/root.rsml"),
    "result/traits.json": ("export", "{corpus}/result", "-o", "{out}/root.csv"),
    "edits.json": ("edit", "{corpus}/result", "--apply", "{file}", "-o", "{out}/edited"),
    "masses.csv": ("biomass", "fit", "{corpus}/traits.csv", "{file}", "-o", "{out}/model.json"),
    "traits.csv": ("growth", "{file}", "-o", "{out}/growth"),
    "specimen of result/roots.rsml": (*SIMULATE, "--specimen", "{file}"),
    "specimen of result/shape.ply": (*SIMULATE, "--specimen", "{file}"),
    "pictures of dataset/dataset.json": ("reconstruct", "{corpus}/dataset", "-o", "{out}/result"),
    **dict.fromkeys(
        ("eight.png", "sixteen.png", "colour.png", "picture.jpg", "deflate.tiff", "lzw.tiff", "bare.tif"),
        ("import", "{pictures}", "--scene", "{corpus}/scene.toml", "-o", "{out}/set"),
    ),
}
SPECIAL: tuple[Callable[[Path], object], ...] = (
    os.mkfifo,
    Path.mkdir,
    lambda path: path.symlink_to(path.name),
    lambda path: path.symlink_to("/dev/zero"),
    lambda path: path.symlink_to("/dev/full"),
    lambda path: os.truncate(os.open(path, os.O_WRONLY | os.O_CREAT), 2**36),
)
"""What stands in place of a file now and then: no file, or a huge one."""
SPECIAL_SHARE = 0.07
WORDS = (
    ("reconstruct", "{corpus}/dataset", "-o", "{out}/r", "--voxel-mm=1", "--mass-g=1"),
    ("simulate", "{corpus}/scene.toml", "-o", "{out}/d", "--seed=1", "--views=8", "--image-wh=32x24", "--samples=1"),
    ("scan", "--rig=twin", "-o", "{out}/s", "--table-angle=0", "--fidelity=sketch", "--profile=bench"),
    ("parts", "{corpus}/scene.toml", "-o", "{out}/b", "--rig={corpus}/rig.toml", "--bed-mm=220x220x250"),
    ("plan", "{corpus}/scene.toml", "-o", "{out}/p", "--views=8,9", "--heights=-42,10:8", "--within=5"),
)
"""Command lines whose words are damaged; they are read, and not carried out."""


class _Nothing:
    args = ()
    kwargs: dict[str, object] = {}  # noqa: RUF012 - empty for ever


def _special(top: str, names: list[str]) -> list[str]:
    """Return what cannot be kept: pipes, and files of many GiB."""
    found = [(name, os.lstat(Path(top, name))) for name in names]
    return [name for name, status in found if stat.S_ISFIFO(status.st_mode) or status.st_size > 2**30]


def _only_read() -> None:
    """Let commands end when their words are read."""
    bind = command_line.bind
    command_line.bind = lambda given: (bind(given) and (lambda: None), _Nothing())


def prepared(name: str, seed: int, work: Path) -> tuple[list[str], bool]:
    """Make the damaged input of a seed; return the command line, and whether it is only read."""
    rng = np.random.default_rng([seed, 17])
    corpus, pictures, out = work / "corpus", work / "pictures", work / "out"
    shutil.copytree(CORPUS, corpus)
    shutil.copytree(corpus / "dataset" / "images", pictures)
    out.mkdir()
    file = name.split(" ")[-1]
    places = {"corpus": str(corpus), "pictures": str(pictures), "out": str(out), "file": str(corpus / file)}
    if name == "words":
        words = [word.format(**places) for word in WORDS[rng.integers(len(WORDS))]]
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(words)))
            strange = STRANGE[rng.integers(len(STRANGE))][:2000].decode().replace("\0", "")
            words[at] = words[at].split("=")[0] + "=" + strange if "=" in words[at] else strange
        return words, True
    is_picture = (CORPUS / file).suffix in (".png", ".jpg", ".tiff", ".tif")
    place = pictures / f"view_9{(CORPUS / file).suffix}" if is_picture else corpus / file
    if rng.random() < SPECIAL_SHARE:
        place.unlink(missing_ok=True)
        SPECIAL[rng.integers(len(SPECIAL))](place)
    else:
        place.write_bytes(mutated((CORPUS / file).read_bytes(), rng))
    return [word.format(**places) for word in COMMANDS[name]], False


def main() -> int:
    """Run for some minutes or inputs, print what was found; return 1 where anything was."""
    parser = argparse.ArgumentParser(prog="./run fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="at most; default: %(default)s")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="at most")
    parser.add_argument("--seed", type=int, default=0, help="of the first input; default: %(default)s")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "rhizotwin-fuzz", help="for finds; default: %(default)s")
    parser.add_argument("--folders", action="store_true", help="folders from somebody hostile instead of damaged files")
    options = parser.parse_args()
    if options.folders:
        return folders.campaign(options.inputs)
    load()
    names = [*COMMANDS, "words"]
    codes: collections.Counter[int] = collections.Counter()
    finds: collections.Counter[str] = collections.Counter()
    longest_s = most_mib = 0.0
    until_s = time.monotonic() + 60.0 * options.minutes
    inputs = 0
    while inputs < options.inputs and time.monotonic() < until_s:
        seed = options.seed + inputs
        name = names[seed % len(names)]
        with tempfile.TemporaryDirectory(prefix="rhizotwin-fuzz-") as place:
            words, only_read = prepared(name, seed, Path(place))
            ended = run(words, Path(place), before=_only_read if only_read else partial(folders.stand_ins, save=False))
            if ended.wrong:
                finds[ended.wrong] += 1
                kept = options.keep / f"{seed}_{name.replace('/', '_').replace(' ', '_')}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(place, kept, symlinks=True, ignore=_special)
                print(f"{ended.wrong}: seed {seed}, {name}, kept in {kept}: {ended.said[-300:]}", flush=True)
        inputs += 1
        codes[ended.code] += 1
        longest_s, most_mib = max(longest_s, ended.seconds), max(most_mib, ended.mib)
    print(json.dumps({"inputs": inputs, "exit codes": dict(codes), "finds": dict(finds)}))
    print(f"longest {longest_s:.2f} s, most memory {most_mib:.0f} MiB")
    return 1 if finds or not inputs else 0


if __name__ == "__main__":
    sys.exit(main())
