"""Kill everything that writes, at random moments, and load the console: ./run campaign --minutes 60 --kills 200.

After each kill, nothing that was complete may be lost, the same command must go on, and its state must be true. Finds are printed, and
end the program with exit code 1. A run with the same seed chooses the same moments, relative to the duration of a command.
"""

# ruff: noqa: T201 - prints a table
import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from tests.campaign import memory, server_load
from tests.campaign.laboratory import Laboratory
from tests.campaign.targets import BENCH, TARGETS, Target, make_ball

SHARES = {"laboratory": 0.25, "catalogue": 0.15, "time-lapse": 0.15, "reconstruct": 0.15, "batch": 0.15, "bench run": 0.15}
"""Share of the kills."""
MOST_KILLS = 12
"""Kills of one command line, which then runs to its end."""
LONGEST_S = 600.0
KILLED = -signal.SIGKILL
Seen = tuple[int, list[str]]


def run(words: list[str], limit_s: float, *, alone: bool) -> tuple[int, str]:
    """Run a command line, killed after some time, alone or with the processes that it has started; return its code and messages."""
    start = ["-c", BENCH] if words[0] == "bench" else ["-m", "rhizotwin"]
    command = [sys.executable, *start, *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        try:
            said = process.communicate(timeout=limit_s)[1]
        except subprocess.TimeoutExpired:
            (os.kill if alone else os.killpg)(process.pid, signal.SIGKILL)
            return process.wait(), ""
    return process.returncode, said


def kill_often(target: Target, rng: np.random.Generator, whole_s: float, kills: int) -> tuple[int, float, list[str]]:
    """Kill a command until it ends; return the number of kills, its duration without one, and what was wrong."""
    words, found, killed = [str(word) for word in target.words()], list[str](), 0
    while True:
        last, begun_s = killed >= min(kills, MOST_KILLS), time.monotonic()
        limit_s = LONGEST_S if last else rng.uniform(0.0, whole_s)
        code, said = run(words, limit_s, alone=bool(rng.random() < 0.5))
        seconds = time.monotonic() - begun_s
        if code not in (0, KILLED) and "is using it" in said:  # a process that was started by the killed one ends within a second
            time.sleep(1.0)
            continue
        if code not in (0, KILLED) or (last and code):
            return killed, whole_s, [*found, f"stuck: exit code {code}: {said[-300:]}"]
        killed += code == KILLED
        try:
            found += [f"lost: {one}" for one in target.lost()]
            if code == 0:
                target.ended()
        except Exception as error:  # noqa: BLE001 - whatever a reader says is a find
            found.append(f"untrue: {type(error).__name__}: {str(error)[:300]}")
        if code == 0:
            return killed, seconds if last else whole_s, found


def commands(name: str, folder: Path, ball: Path, rng: np.random.Generator, kills: int, until_s: float) -> Seen:
    """Kill the commands of one kind."""
    _, whole_s, found = kill_often(TARGETS[name](folder / "0", ball), rng, 0.0, 0)  # how long it takes
    done, number = 0, 1
    while done < kills and time.monotonic() < until_s and not found:
        killed, whole_s, found = kill_often(TARGETS[name](folder / str(number), ball), rng, whole_s, kills - done)
        done, number = done + killed, number + 1
    return done, found


def laboratory(folder: Path, ball: Path, rng: np.random.Generator, kills: int, until_s: float) -> Seen:
    """Kill consoles and their reconstructions."""
    lab, found, done = Laboratory(folder, ball), list[str](), 0
    while done < kills and time.monotonic() < until_s and not found:
        found += lab.attack(rng)
        done += 1
    return done, found or lab.attack(rng, kill=False)


def load(folder: Path) -> Seen:
    """Measure the console under the load of many clients and connections."""
    found = server_load.measure(folder)
    limits = {name: 1.1 if name.startswith("scan") else 1.0 for name in found}
    return 0, [f"{name}: {value:.2f}, at most {limits[name]}" for name, value in found.items() if value > limits[name]]


def remembered(folder: Path) -> Seen:
    """Measure the memory of the console."""
    change_mib = memory.main(folder)
    return 0, [f"memory changed by {change_mib:.0f} MiB"] * (change_mib > memory.MOST_MIB)


def main() -> int:
    """Run all parts, and print a table; return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="./run campaign", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, help="at most, apart from load and memory; default: %(default)s")
    parser.add_argument("--kills", type=int, default=200, help="at most; default: %(default)s")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=[*SHARES, "load", "memory"], help="one part")
    options = parser.parse_args()
    shares = SHARES if options.only is None else {name: 1.0 for name in SHARES if name == options.only}
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="rhizotwin-campaign-") as place:
        folder, rng = Path(place), np.random.default_rng(options.seed)
        ball = make_ball(folder / "made") if options.only not in ("load", "memory") else folder
        begun_s, spent = time.monotonic(), 0.0
        print(f"{'part':<12}{'kills':>6}{'finds':>6}{'minutes':>9}", flush=True)

        def report(name: str, part: Callable[[], Seen]) -> None:
            nonlocal wrong
            part_s = time.monotonic()
            kills, found = part()
            if not kills and name in SHARES:
                found = [*found, "nothing was killed; give more --minutes"]
            wrong += len(found)
            print(f"{name:<12}{kills:>6}{len(found):>6}{(time.monotonic() - part_s) / 60.0:>9.1f}", *found, sep="\n  ", flush=True)

        for name, share in shares.items():
            spent += share
            kills, until_s = round(options.kills * share), begun_s + 60.0 * options.minutes * spent
            (folder / name).mkdir()
            attack = laboratory if name == "laboratory" else partial(commands, name)
            report(name, partial(attack, folder / name, ball, rng, kills, until_s))
        for name, part in (("load", load), ("memory", remembered)):
            if options.only is None or options.only == name:
                report(name, partial(part, folder / name))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
