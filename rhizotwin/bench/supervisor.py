"""Program that runs a method in a folder, measures it, and ends all of its processes.

It runs in a process of its own, and uses only the standard library: Linux includes the memory of the parent in the peak
memory of a child process, so the parent must be small. The first line of its input is a command. It prints the
measurements, and waits for the end of its input, which also comes when the benchmark is killed. Then it ends all
processes that the method has started, removes the folder and exits.

On Linux, processes whose parent has ended become children of this program, even if they have started a session of their
own. Elsewhere, those that have left the tree of processes are not found.
"""

import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

ORPHANS_COME_HERE = 36
"""PR_SET_CHILD_SUBREAPER of prctl(2)."""
PATIENCE_S = 10.0
"""Maximum time until all killed processes have ended, s. A process that waits for a device may take longer."""


def run(words: list[str], timeout_s: float, output: str) -> dict[str, object]:
    """Run a command, and return its exit code, processor time and memory, or that it exceeded the time limit."""
    with Path(output).open("wb") as stream:
        try:
            child = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, start_new_session=True)
        except OSError as error:
            stream.write(f"{words[0]} cannot be started: {error.strerror}".encode())
            return {"exit_code": 1}
        try:
            measured: dict[str, object] = {"exit_code": child.wait(timeout_s)}
            with contextlib.suppress(ImportError):  # Windows
                import resource

                used = resource.getrusage(resource.RUSAGE_CHILDREN)
                unit = 1024.0**2 if sys.platform == "darwin" else 1024.0  # bytes there, KiB elsewhere
                measured |= {"cpu_s": used.ru_utime + used.ru_stime, "memory_mib": used.ru_maxrss / unit}
        except subprocess.TimeoutExpired:
            measured = {"timeout": True}
        end_all(child.pid)
        return measured


def end_all(first: int | None) -> None:
    """Kill the first process of the method with its tree, and all other processes that this program has started."""
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/F", "/T", "/PID", str(first)], capture_output=True, check=False)
        return
    end_s = time.monotonic() + PATIENCE_S
    while (found := descendants()) and time.monotonic() < end_s:
        for process in found:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        time.sleep(0.01)
    with contextlib.suppress(ChildProcessError):  # entries of ended processes are removed by their parent
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def descendants() -> list[int]:
    """Return the processes that descend from this one, and have not ended."""
    parents = {}
    if sys.platform == "linux":
        for folder in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ValueError):  # it is not that of a process, or the process has ended
                state, parent = (folder / "stat").read_bytes().rpartition(b")")[2].split()[:2]
                parents[int(folder.name)] = (int(parent), state == b"Z")
    else:
        with subprocess.Popen(["ps", "-A", "-o", "pid=,ppid=,stat="], stdout=subprocess.PIPE, text=True) as lister:
            for line in lister.communicate()[0].splitlines():
                process, shown, status = line.split()[:3]
                parents[int(process)] = (int(shown), status.startswith("Z") or int(process) == lister.pid)
    found = []
    waiting = [os.getpid()]
    while waiting:
        above = waiting.pop()
        below = [process for process, (parent, _) in parents.items() if parent == above]
        waiting += below
        found += [process for process in below if not parents[process][1]]
    return found


def main(folder: str) -> None:
    """Run the command in the input, and clean up at the end of the input."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(ORPHANS_COME_HERE, 1, 0, 0, 0)
    task = json.loads(sys.stdin.readline() or "null")

    def clean() -> None:
        sys.stdin.read()
        end_all(None)
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    watching = threading.Thread(target=clean)
    watching.start()
    if task is not None:
        with contextlib.suppress(OSError):  # the benchmark was killed, and the folder is removed
            sys.stdout.write(json.dumps(run(task["words"], task["timeout_s"], f"{folder}/output.txt")) + "\n")
            sys.stdout.flush()
    watching.join()


if __name__ == "__main__":
    main(sys.argv[1])
