"""`rhizotwin demo`."""

from pathlib import Path

from rhizotwin import command_steps
from rhizotwin.arguments import Device, OutputFolder, Profile, Progress


def demo(
    *, output: OutputFolder = Path("demo"), profile: Profile = "clean", device: Device = "auto", progress: Progress = Progress()
) -> None:
    """Take all three steps on a small printed root: a few minutes.

    Simulate a small printed root, reconstruct it from the pictures alone, score it, and make pictures of what was
    found.

    Parameters
    ----------
    output : Path
        Folder for everything; a finished demo in it is replaced, a stopped one taken up.
    profile : str
        What the rig gets wrong.
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin demo
    rhizotwin demo -o my_demo --profile bench
    """
    from rhizotwin.demo import demo as run_demo

    command_steps.start_engine(device, quiet=progress.quiet)
    run_demo(output, profile=profile, say=print, progress=progress)
