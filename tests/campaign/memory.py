"""Memory of the console during a time-lapse of many scans. It must not grow."""

import os
import sys
import time
from pathlib import Path

from rhizotwin.console.access import Access
from rhizotwin.console.client import Console as Client
from rhizotwin.console.console import Console
from rhizotwin.console.serve import serve
from rhizotwin.steps import rigs
from rhizotwin.timelapse.experiment import load_experiment
from tests.rhizotwin.timelapse.conftest import write_experiment

PLANTS = 6
WARM_H = 4
"""Hours after which libraries are loaded and caches are full."""
MOST_MIB = 20.0


def resident_mib() -> float:
    """Return the memory of this process, MiB (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def hourly_mib(folder: Path, hours: int) -> list[float]:
    """Scan six plants every simulated hour, with a client that confirms each canister; return the memory at the end of each hour."""
    folder.mkdir(parents=True)
    experiment = load_experiment(write_experiment(folder, plants=PLANTS, rounds=hours, schedule="every_h = 1.0\nlate_h = 0.9"))
    twin = rigs.TwinPictures(fidelity="sketch", profile="clean")
    bench = rigs.twin_bench(experiment.base_scene(), twin)
    console = Console(bench, experiment.folder, experiment=experiment)
    served = serve(console, Access(), host="127.0.0.1", port=8780)
    client, found = Client(served.address), list[float]()
    try:
        client.take_control("campaign")
        client.start_schedule()
        while (state := client.state())["activity"]:
            if state["question"]:
                client.answer("", question=state["question_number"])
            client.request("GET", "/api/hull")
            if state["schedule"]["scanned"] >= PLANTS * (len(found) + 1):
                found.append(resident_mib())
            time.sleep(0.02)
        assert (state["schedule"]["scanned"], state["schedule"]["missed_count"]) == (PLANTS * hours, 0), state["messages"]
    finally:
        served.stop()
        console.close()
    return found


def main(folder: Path, hours: int = 24) -> float:
    """Return by how much the memory changed after the first hours, MiB."""
    found = hourly_mib(folder, hours)
    sys.stdout.write(f"memory at the end of each hour, MiB: {' '.join(f'{one:.0f}' for one in found)}\n")
    return max(found[WARM_H:]) - min(found[WARM_H:])
