"""`rhizotwin reconstruct`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from rhizotwin import command_steps
from rhizotwin.arguments import DatasetFolder, Device, Flag, MassG, OutputResult, Progress, VoxelMm, list_of, option, with_metavar

if TYPE_CHECKING:
    from rhizotwin.recon.settings import PictureSettings


@Parameter(name="*", group="Method")
@dataclass(frozen=True, kw_only=True)
class Study:
    """Options for the study of the method."""

    settings: Annotated[Path | None, with_metavar("FILE")] = None
    """TOML file with settings of the stages (docs/settings.md); --voxel-mm overrides its voxel size."""
    keep_stages: Flag = False
    """Save the intermediate results of the stages in RESULT/stages (docs/datasets.md): cameras, coverage, hull, \
roots, solid."""
    method: Literal["ours", "thesis", "regularised", "hull"] = "ours"
    """Reconstruction method: ours, or a baseline for comparison, whose volume is always marked as not reliable: hull \
(visual hull), regularised (regularised visual hull, Zheng et al. 2011), thesis (method of Kliman's thesis, \
2022)."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PictureChoice:
    """Selection of the pictures."""

    leave_out: Annotated[tuple[str, ...], option(list_of(str), "FILE,FILE,...")] = ()
    """File names of pictures to exclude."""
    tolerant: Flag = False
    """Exclude pictures that are missing or cannot be read, instead of stopping with an error."""

    @property
    def settings(self) -> "PictureSettings":
        """Picture settings of the reconstruction."""
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
    """Reconstruct root shape and volume from the pictures of a dataset.

    The camera poses are estimated from the marker strip, the silhouettes are segmented, and the roots are fitted to the
    silhouettes of all views, including refraction. The ground truth of a simulated dataset is only shown next to the
    result. Pictures that contradict all others, such as an incomplete file, are excluded with a warning.

    Parameters
    ----------
    dataset : Path
        Dataset folder, written by 'rhizotwin simulate', 'scan' or 'import'.
    output : Path
        Result folder to write: new, empty, or an earlier result, which is replaced.
    voxel_mm : float
        Edge length of the smallest voxels, 0.01 to 10 mm, default 0.27; smaller voxels take longer.
    mass_g : float, optional
        Fresh mass of the roots in grams, for specific root length and tissue density.
    pictures : PictureChoice
        Selection of the pictures.
    study : Study
        Options for the study of the method.
    device : str
        Compute device: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available).
    progress : Progress
        Progress output; quiet prints only the volume, verbose also the calibration.

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
    _print_summary(json.loads((output / "result.json").read_text(encoding="utf-8")), progress)
    if progress.quiet:
        return
    if progress.verbose:
        for path in written:
            print(f"  {path}")
    print(f"report: {output / 'report.html'}")
    print(f"next: rhizotwin view {output}")
    if (dataset / "truth").is_dir():
        print(f"or:   rhizotwin score {output} {dataset}")


def _print_summary(summary: dict[str, Any], progress: Progress) -> None:
    """Print volume, traits and warnings."""
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
    for line in words.root_summary(summary):
        print(line)
    if summary["volume_trusted"]:
        for sentence in words.uncertainty_causes(summary)[:1]:
            print(sentence)
