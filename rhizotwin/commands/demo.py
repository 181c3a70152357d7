"""Command `rhizotwin demo`."""

from pathlib import Path

from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import Device, OutputFolder, Profile, Progress


def demo(
    *, output: OutputFolder = Path("demo"), profile: Profile = "clean", device: Device = "auto", progress: Progress = Progress()
) -> None:
    """Simulate, reconstruct and score a small printed root (a few minutes).

    The demonstration renders pictures of a small 3D-printed root, reconstructs the root from these pictures, compares
    the result with the true root, and writes a report.

    Parameters
    ----------
    output : Path
        Folder for all files; a finished demonstration in the folder is replaced, and an interrupted one is continued.
    profile : str
        Simulated imperfections of rig and pictures: clean (none), bench (well-built rig), camera (bench with an
        ordinary camera), harsh (badly adjusted rig), real (first scan of a living plant), or a TOML file.
    device : str
        Device for the computation: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available).
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin demo
    rhizotwin demo -o my_demo --profile bench
    """
    from rhizotwin.steps.demo import demo as run_demo

    command_steps.start_engine(device, quiet=progress.quiet)
    run_demo(output, profile=profile, say=print, progress=progress)
