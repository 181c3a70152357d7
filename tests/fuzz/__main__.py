"""Give damaged files to the commands, each in a process of its own, and count how they end: ./run fuzz --minutes 10.

A command may succeed (0) or say in one sentence what to put right (2). Anything else is a find: exit 1 or a signal, a traceback, an
"unexpected error", libraries' own lines on stderr, more time or memory than a small file can need. Finds are kept with their seed.
"""

import argparse
import collections
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rhizotwin import cli, command_line, engine
from tests.fuzz.mutate import STRANGE, mutated

CORPUS = Path(__file__).parent / "corpus"
LIMIT_S = 60.0  # by the clock: on a machine with eight runs a processor, pages of results took 15
LIMIT_MIB = 2048
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
    **dict.fromkeys(
        ("eight.png", "sixteen.png", "colour.png", "picture.jpg", "deflate.tiff", "lzw.tiff", "bare.tif"),
        ("import", "{pictures}", "--scene", "{corpus}/scene.toml", "-o", "{out}/set"),
    ),
}
WORDS = (
    ("reconstruct", "{corpus}/dataset", "-o", "{out}/r", "--voxel-mm=1", "--mass-g=1"),
    ("simulate", "{corpus}/scene.toml", "-o", "{out}/d", "--seed=1", "--views=8", "--image-wh=32x24", "--samples=1"),
    ("scan", "--rig=twin", "-o", "{out}/s", "--table-angle=0", "--fidelity=sketch", "--profile=bench"),
    ("parts", "{corpus}/scene.toml", "-o", "{out}/b", "--rig={corpus}/rig.toml", "--bed-mm=220x220x250"),
    ("plan", "{corpus}/scene.toml", "-o", "{out}/p", "--views=8,9", "--heights=-42,10:8", "--within=5"),
)
"""Command lines whose words are damaged; they are read, and not carried out."""


@dataclass(frozen=True)
class Ended:
    """How one command ended."""

    code: int
    seconds: float
    mib: float
    said: str

    @property
    def wrong(self) -> str:
        """What must not be; empty where all is well."""
        lines = [line for line in self.said.splitlines() if line.strip()]
        if self.seconds >= LIMIT_S:
            return "hangs"
        if self.code not in (0, cli.EXIT_MISTAKE):
            return f"exit {self.code}"
        if "Traceback" in self.said or "unexpected error" in self.said:
            return "traceback"
        if self.mib > LIMIT_MIB:
            return "memory"
        strange = [line for line in lines if not line.startswith("rhizotwin: ") and "%|" not in line]
        return "strange lines" if self.code == cli.EXIT_MISTAKE and strange else ""


def run(words: list[str], work: Path, *, only_read: bool) -> Ended:
    """Run a command line in a child of this process."""
    begun_s = time.monotonic()
    said = work / "stderr"
    child = os.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(os.open(work / "stdout", os.O_WRONLY | os.O_CREAT), 1)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT), 2)
        code = 70
        try:
            if only_read:
                bind = command_line.bind
                command_line.bind = lambda given: (bind(given) and (lambda: None), _Nothing())
            code = cli.main(words)
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 70
        except BaseException:  # noqa: BLE001 - what passes the command line's own last line is a find
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(code)
    while True:
        ended, status, used = os.wait4(child, os.WNOHANG)
        seconds = time.monotonic() - begun_s
        if ended:
            break
        if seconds > LIMIT_S:
            os.kill(child, signal.SIGKILL)
            os.wait4(child, 0)
            return Ended(-9, seconds, 0.0, "")
        time.sleep(0.002)
    per_mib = 2**10 if sys.platform == "linux" else 2**20
    return Ended(os.waitstatus_to_exitcode(status), seconds, used.ru_maxrss / per_mib, said.read_text(errors="replace"))


class _Nothing:
    args = ()
    kwargs: dict[str, object] = {}  # noqa: RUF012 - empty for ever


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
    damaged = mutated((CORPUS / file).read_bytes(), rng)
    if (CORPUS / file).suffix in (".png", ".jpg", ".tiff", ".tif"):
        (pictures / f"view_9{(CORPUS / file).suffix}").write_bytes(damaged)
    else:
        (corpus / file).write_bytes(damaged)
    return [word.format(**places) for word in COMMANDS[name]], False


def main() -> int:
    """Run for some minutes or inputs, print what was found; return 1 where anything was."""
    parser = argparse.ArgumentParser(prog="./run fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="at most; default: %(default)s")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="at most")
    parser.add_argument("--seed", type=int, default=0, help="of the first input; default: %(default)s")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "rhizotwin-fuzz", help="for finds; default: %(default)s")
    options = parser.parse_args()
    _load()
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
            ended = run(words, Path(place), only_read=only_read)
            if ended.wrong:
                finds[ended.wrong] += 1
                kept = options.keep / f"{seed}_{name.replace('/', '_').replace(' ', '_')}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(place, kept)
                print(f"{ended.wrong}: seed {seed}, {name}, kept in {kept}: {ended.said[-300:]}", flush=True)
        inputs += 1
        codes[ended.code] += 1
        longest_s, most_mib = max(longest_s, ended.seconds), max(most_mib, ended.mib)
    print(json.dumps({"inputs": inputs, "exit codes": dict(codes), "finds": dict(finds)}))
    print(f"longest {longest_s:.2f} s, most memory {most_mib:.0f} MiB")
    return 1 if finds or not inputs else 0


def _load() -> None:
    """Load what the commands need once, before the children."""
    import rhizotwin.building.write
    import rhizotwin.exports
    import rhizotwin.importer
    import rhizotwin.rig.bench  # noqa: F401

    os.environ.pop(cli.DEBUG_VARIABLE, None)
    engine.start = lambda *_: "no engine"  # its threads do not survive a fork, and files need none
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    sys.exit(main())
