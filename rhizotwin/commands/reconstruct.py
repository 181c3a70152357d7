"""Command `rhizotwin reconstruct`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import (
    Computing,
    DatasetFolder,
    Flag,
    MassG,
    OutputResult,
    Progress,
    VoxelMm,
    list_of,
    option,
    read_integer,
    with_metavar,
)

if TYPE_CHECKING:
    from rhizotwin.recon.settings import Settings


@Parameter(name="*", group="Method")
@dataclass(frozen=True, kw_only=True)
class Study:
    """Options for studying the reconstruction method."""

    keep_stages: Flag = False
    """Save intermediate results (cameras, silhouettes, hull, roots, solid) in the subfolder stages of the result \
(docs/datasets.md)."""
    method: Literal["ours", "thesis", "regularised", "hull"] = "ours"
    """Reconstruction method: ours (full method), or for comparison hull (visual hull), regularised (regularised \
visual hull, Zheng et al. 2011) or thesis (method of Kliman's thesis, 2022). The methods for comparison always mark \
the volume as not reliable."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SettingsOptions:
    """Options for the settings of the reconstruction, among them the selection of the pictures."""

    voxel_mm: VoxelMm | None = None
    """Edge length of the smallest voxels in mm, 0.01 to 10; default: 0.27. Smaller voxels take longer."""
    settings: Annotated[Path | None, with_metavar("FILE")] = None
    """TOML file with settings of the reconstruction (docs/settings.md); --voxel-mm overrides its voxel size."""
    leave_out: Annotated[tuple[str, ...], option(list_of(str), "FILE,FILE,...")] = ()
    """File names of pictures to exclude, separated by commas."""
    tolerant: Flag = False
    """Exclude pictures that are missing or unreadable, instead of stopping with an error."""
    hold_out: Annotated[int | None, option(lambda text: read_integer(text, 2, 1000, "give 2 to 1000"), "N")] = None
    """Hold out every N-th picture, with which 'rhizotwin verify' compares the result."""

    def load(self) -> "Settings":
        """Return the settings of the file, or the defaults, with the other options."""
        from rhizotwin.recon.settings import PictureSettings

        pictures = PictureSettings(leave_out=self.leave_out, tolerant=self.tolerant, hold_out=self.hold_out or 0)
        return command_steps.settings_of(self.settings, voxel_mm=self.voxel_mm, pictures=pictures)


def reconstruct(
    dataset: DatasetFolder,
    /,
    *,
    output: OutputResult,
    mass_g: MassG | None = None,
    settings: SettingsOptions = SettingsOptions(),
    study: Study = Study(),
    computing: Computing = Computing(),
) -> None:
    """Reconstruct root shape and volume from the pictures of a dataset.

    The camera poses are estimated from the markers around the net pot, and the roots are fitted to their silhouettes in
    all views, including refraction. The true roots of a simulated dataset are not used.
    Pictures that are inconsistent with all others, such as a damaged file, are excluded with a warning.

    Parameters
    ----------
    dataset : Path
        Dataset (folder with the pictures of a scan), written by 'rhizotwin simulate', 'scan' or 'import'.
    output : Path
        Folder for the result: new, empty, or an earlier result, which is replaced.
    mass_g : float, optional
        Fresh mass of the roots in grams, from which specific root length and tissue density are computed.
    settings : SettingsOptions
        Settings, and selection of the pictures.
    study : Study
        Options for studying the method.
    computing : Computing
        Device of the computation, and progress output; --quiet also shortens the summary, and --verbose also prints the
        calibration.

    Examples
    --------
    rhizotwin reconstruct my_dataset -o my_result
    rhizotwin reconstruct my_dataset -o my_result --voxel-mm 0.1
    rhizotwin reconstruct my_dataset -o my_result --mass-g 1.18
    rhizotwin reconstruct my_dataset -o my_hull --method hull
    rhizotwin reconstruct my_dataset -o my_result --leave-out view_007.png,view_012.png
    rhizotwin reconstruct my_dataset -o my_result --settings my_settings.toml --keep-stages
    """
    command_steps.start_engine(computing.device, quiet=computing.quiet)
    wanted = command_steps.Wanted(settings=settings.load(), mass_g=mass_g, **vars(study))
    written = command_steps.reconstruct_whole(dataset, output, wanted, progress=computing)
    _print_summary(json.loads((output / "result.json").read_text(encoding="utf-8")), mass_g, computing)
    if computing.quiet:
        return
    if computing.verbose:
        for path in written:
            print(f"  {path}")
    print(f"report: {output / 'report.html'}")
    print(f"to see the result in 3D: rhizotwin view {output}")
    if (dataset / "truth").is_dir():
        print(f"to compare it with the true roots: rhizotwin score {output} {dataset}")


def _print_summary(summary: dict[str, Any], mass_g: float | None, progress: Progress) -> None:
    """Print the volume and the main traits of a result, its warnings, and a note if the density is not plausible."""
    from rhizotwin.report import words
    from rhizotwin.scenes.traits import density_note
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
    if mass_g is not None and summary["volume_mm3"] and (note := density_note(1000.0 * mass_g / summary["volume_mm3"])):
        print(f"note: with {mass_g:g} g, the fresh mass per volume is {note}")
    if progress.quiet:
        return
    for line in words.root_summary(summary):
        print(line)
    if summary["volume_trusted"] and (cause := words.main_cause(summary)):
        print(cause)
