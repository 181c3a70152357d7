"""`rhizotwin reconstruct`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from rhizotwin import command_steps
from rhizotwin.arguments import DatasetFolder, Device, Flag, MassG, OutputResult, Progress, VoxelMm, list_of, named, option

if TYPE_CHECKING:
    from rhizotwin.recon.settings import PictureSettings


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Study:
    """What those give who study the method."""

    settings: Annotated[Path | None, named("FILE")] = None
    """TOML file of settings of the stages (docs/settings.md); --voxel-mm overrides it."""
    keep_stages: Flag = False
    """Keep what each stage made in RESULT/stages (docs/datasets.md): cameras, coverage, hull, roots, solid."""
    method: Literal["ours", "thesis", "regularised", "hull"] = "ours"
    """ours, or a baseline whose volume is never trusted: thesis (the method of the thesis of 2022), regularised (the
    regularised visual hull of Zheng et al. 2011, which the thesis proposes), hull (the untrimmed visual hull)."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PictureChoice:
    """Which pictures are used."""

    leave_out: Annotated[tuple[str, ...], option(list_of(str), "FILE,FILE,...")] = ()
    """Pictures to leave out, by the names of their files."""
    tolerant: Flag = False
    """Leave out pictures that are missing or cannot be read, instead of stopping at the first."""

    @property
    def settings(self) -> "PictureSettings":
        """Return the settings of a reconstruction."""
        from rhizotwin.recon.settings import PictureSettings

        return PictureSettings(leave_out=self.leave_out, tolerant=self.tolerant)


def reconstruct(
    dataset: DatasetFolder,
    /,
    *,
    output: OutputResult,
    voxel_mm: VoxelMm | None = None,
    mass_g: MassG | None = None,
    pictures: PictureChoice = PictureChoice(),
    study: Study = Study(),
    device: Device = "auto",
    progress: Progress = Progress(),
) -> None:
    """Find the root's shape and volume in a dataset's pictures.

    Find the cameras from the marker strip, the silhouettes from the pictures, and the root's shape and volume from
    both. The truth of a simulated dataset is only drawn beside the result, never used. Single pictures that contradict
    all others, such as a half-written one, are left out with a warning.

    Parameters
    ----------
    dataset : Path
        Folder made by 'rhizotwin simulate' or 'rhizotwin import'.
    output : Path
        Folder to write the result to: new, empty, or an earlier result, which is replaced.
    voxel_mm : float
        Edge of the smallest voxels, 0.01 to 10 mm, 0.27 if not given; smaller is slower and finer.
    mass_g : float, optional
        Mass of the roots, if weighed: gives specific root length and tissue density.
    pictures : PictureChoice
        Which pictures are used.
    study : Study
        For who studies the method.
    device : str
        What computes: cpu, cuda (an NVIDIA GPU), auto (the GPU if there is one).
    progress : Progress
        How much is told meanwhile; quiet prints the volume alone, verbose also what the scan calibrated by itself.

    Examples
    --------
    rhizotwin reconstruct my_dataset -o my_result
    rhizotwin reconstruct my_dataset -o my_result --voxel-mm 0.1
    rhizotwin reconstruct my_dataset -o my_result --mass-g 1.18
    rhizotwin reconstruct my_dataset -o my_hull --method hull
    rhizotwin reconstruct my_dataset -o my_result --leave-out view_007.png,view_012.png
    rhizotwin reconstruct my_dataset -o my_result --settings my_settings.toml --keep-stages
    """
    command_steps.start_engine(device, quiet=progress.quiet)
    settings = command_steps.settings_of(study.settings, voxel_mm=voxel_mm, pictures=pictures.settings)
    kept: dict[str, Any] = {"keep_stages": study.keep_stages, "method": study.method}
    written = command_steps.reconstruct_whole(dataset, output, settings=settings, mass_g=mass_g, progress=progress, **kept)
    _tell(json.loads((output / "result.json").read_text(encoding="utf-8")), progress)
    if progress.quiet:
        return
    if progress.verbose:
        for path in written:
            print(f"  {path}")
    print(f"look at it: {output / 'report.html'}")
    print(f"next: rhizotwin view {output}")
    if (dataset / "truth").is_dir():
        print(f"or:   rhizotwin score {output} {dataset}")


def _tell(summary: dict[str, Any], progress: Progress) -> None:
    """Print what was found."""
    from rhizotwin.report import words
    from rhizotwin.stored import calibration_table

    for warning in summary["warnings"]:
        print(f"warning: {warning}")
    if progress.verbose:
        for line in calibration_table.table(summary["rig"]):
            print(line)
    if progress.verbose and summary["root_mu_per_mm"] is not None:
        sigma = summary["root_mu_sigma_per_mm"]
        print(f"translucent roots: attenuation {summary['root_mu_per_mm']:.3g}{'' if sigma is None else f' +- {sigma:.2g}'} per mm")
    headline, beside = words.headline(summary)
    used = sum(view["used"] for view in summary["views"])
    print(f"{headline}, {beside}; {used} of {len(summary['views'])} views used")
    if progress.quiet:
        return
    for line in words.roots_told(summary):
        print(line)
    if summary["volume_trusted"]:
        for sentence in words.budget(summary)[:1]:
            print(sentence)
