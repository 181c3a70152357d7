"""`rhizotwin reconstruct`."""

import json
from pathlib import Path
from typing import Annotated

from rhizotwin import steps
from rhizotwin.arguments import DatasetFolder, Device, MassG, OutputResult, VoxelMm, named


def reconstruct(
    dataset: DatasetFolder,
    /,
    *,
    output: OutputResult,
    voxel_mm: VoxelMm | None = None,
    settings: Annotated[Path | None, named("FILE")] = None,
    mass_g: MassG | None = None,
    device: Device = "auto",
) -> None:
    """Find the root's shape and volume in a dataset's pictures.

    Find the cameras from the marker strip, the silhouettes from the pictures, and the root's shape and volume from both. The truth of a
    simulated dataset is only drawn beside the result, never used.

    Parameters
    ----------
    dataset : Path
        Folder made by 'rhizotwin simulate' or 'rhizotwin import'.
    output : Path
        Folder to write the result to: new, empty, or an earlier result, which is replaced.
    voxel_mm : float
        Edge of the smallest voxels, 0.01 to 10 mm, 0.27 if not given; smaller is slower and finer.
    settings : Path, optional
        TOML file of what may be set, for who studies the method (docs/settings.md); --voxel-mm goes before it.
    mass_g : float, optional
        Mass of the roots, if weighed: gives specific root length and tissue density.
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).

    Examples
    --------
    rhizotwin reconstruct my_dataset -o my_result
    rhizotwin reconstruct my_dataset -o my_result --voxel-mm 0.1
    rhizotwin reconstruct my_dataset -o my_result --mass-g 1.18
    rhizotwin reconstruct my_dataset -o my_result --settings my_settings.toml
    """
    steps.start_engine(device)
    from rhizotwin.recon.results import calibrated

    written = steps.reconstruct_whole(dataset, output, voxel_mm=voxel_mm, settings=settings, mass_g=mass_g)
    summary = json.loads((output / "result.json").read_text(encoding="utf-8"))
    low, high = summary["volume_interval_mm3"]
    used = sum(view["used"] for view in summary["views"])
    for warning in summary["warnings"]:
        print(f"warning: {warning}")
    for line in calibrated.table(summary["rig"]):
        print(line)
    if summary["root_mu_per_mm"] is not None:
        sigma = summary["root_mu_sigma_per_mm"]
        print(f"translucent roots: attenuation {summary['root_mu_per_mm']:.3g}{'' if sigma is None else f' +- {sigma:.2g}'} per mm")
    print(
        f"volume {summary['volume_mm3']:.1f} mm3, 90 % interval {low:.1f} to {high:.1f} mm3; {used} of {len(summary['views'])} views used"
    )
    if summary["volume_trusted"]:
        worst = max(summary["volume_budget"], key=lambda term: max(term["less_mm3"], term["more_mm3"]), default=None)
        if worst is not None:
            print(f"most uncertain: {worst['why']} (-{worst['less_mm3']:.1f}, +{worst['more_mm3']:.1f} mm3)")
    print("pictures to look at:")
    for path in written:
        print(f"  {path}")
    if (dataset / "truth").is_dir():
        print(f"next: rhizotwin score {output} {dataset}")
