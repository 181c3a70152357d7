"""`rhizotwin demo`."""

from pathlib import Path

from rhizotwin import command_steps
from rhizotwin.arguments import Device, OutputFolder, Profile, Progress


def demo(
    *, output: OutputFolder = Path("demo"), profile: Profile = "clean", device: Device = "auto", progress: Progress = Progress()
) -> None:
    """Simulate, reconstruct and score a small printed root (a few minutes).

    Render pictures of a small 3D-printed root, reconstruct it from these pictures, compare the result with the ground
    truth, and write a report.

    Parameters
    ----------
    output : Path
        Folder for all files. A finished demo in it is replaced, an interrupted one continued.
    profile : str
        Simulated errors of the rig: clean (none), bench (a well-built rig), camera (bench with an ordinary camera),
        harsh (a badly adjusted rig), real (a first scan of a living plant), or a TOML file.
    device : str
        Compute device: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available).
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin demo
    rhizotwin demo -o my_demo --profile bench
    """
    from rhizotwin.demo import demo as run_demo

    command_steps.start_engine(device, quiet=progress.quiet)
    run_demo(output, profile=profile, say=print, progress=progress)
