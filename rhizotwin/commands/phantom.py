"""Command `rhizotwin phantom`."""

from typing import Annotated

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.arguments import ResultFolder, list_of, option, read_number

WIRE_LIMITS_MM, MASS_LIMITS_MG = (0.01, 10.0), (0.1, 1e6)
WIRES_MM = (0.1, 0.2, 0.4, 0.8)


def read_wire_mm(text: str) -> float:
    """Convert text to the diameter of a wire in mm."""
    return read_number(text, WIRE_LIMITS_MM, "mm", "millimetres")


def phantom(
    result: ResultFolder,
    /,
    *,
    wires_mm: Annotated[tuple[float, ...] | None, option(list_of(read_wire_mm), "MM,MM,...")] = None,
    mg_per_m: Annotated[
        tuple[float, ...] | None, option(list_of(lambda text: read_number(text, MASS_LIMITS_MG, "mg/m")), "MG,MG,...")
    ] = None,
) -> int:
    """Compare a scan of copper wires with the known diameters of the wires.

    The measured cross-section (volume per length) of each wire is compared with the true cross-section, which shows the
    smallest root diameter that the rig can measure. The exit code is 1 if the error of a wire exceeds 3 %.

    Parameters
    ----------
    result : Path
        Result folder of a scan of the wires, written by 'rhizotwin reconstruct'.
    wires_mm : tuple of float, optional
        Diameters of the wires in mm, separated by commas; default: 0.1,0.2,0.4,0.8.
    mg_per_m : tuple of float, optional
        Comma-separated mass per metre of each wire in mg/m, as an alternative to the diameters. To determine it, weigh
        a piece of known length.

    Examples
    --------
    rhizotwin phantom my_result
    rhizotwin phantom my_result --mg-per-m 69.8,283.1,1129,4493
    """
    from rhizotwin.experiment.phantom import diameter_of, measure_wires

    if wires_mm is not None and mg_per_m is not None:
        raise UserError("--wires-mm and --mg-per-m cannot be used together; remove one of them")
    diameters = wires_mm or (WIRES_MM if mg_per_m is None else tuple(diameter_of(mass) for mass in mg_per_m))
    found = measure_wires(result, diameters)
    print("wire (mm)  length (mm)  volume (mm3)  error of the cross-section")
    for one in found:
        error = f"{100.0 * one.error:+.1f} %" if one.length_mm else "-"
        print(f"{one.diameter_mm:9.4g}  {one.length_mm:11.1f}  {one.volume_mm3:12.4g}  {error:>8}  {one.verdict}")
    return int(any(not one.is_measured for one in found))
