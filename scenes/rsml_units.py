"""Units of an RSML file. They are the unit of its coordinates, and the units of its properties and functions."""

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from rhizotwin.scenes import rsml_xml
from rhizotwin.scenes.errors import UserError

_UNITS_MM = {
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre"), 1e-3),
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters", "millimetres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimetre", "centimeters", "centimetres"), 10.0),
    **dict.fromkeys(("m", "meter", "metre", "meters", "metres"), 1000.0),
    **dict.fromkeys(("inch", "inches", "in"), 25.4),
}
_SET_UNIT = (
    "state it in the file, or give the size of one coordinate unit, such as '0.1 mm', to simulate with --specimen-unit, or as unit in a "
    "scene file"
)
_PIXEL = re.compile(r"(?:px|pixels?)(?:\s*[\[(]\s*([^\])\s]*)\s*[\])])?", re.IGNORECASE)
"""Regular expression for a unit in pixels. RootSystemTracker (4679932) writes "pixel(um)", and the size of a pixel as
the metadata entry "size"."""
_PIXEL_SIZES = ("size", "pixel_size", "pixel-size", "resolution")
SIZE_MM = (10.0, 3000.0)
"""Plausible largest extent of a root system, mm: seedlings of a few days, and the deepest roots of field crops
(2 to 3 m)."""
THICKNESS_MM = (0.05, 30.0)
"""Plausible mean diameter of the roots of a plant, mm. The finest laterals of cereals and Arabidopsis are about 0.05 mm
thick. A storage root without its laterals, such as a carrot, is about 30 mm thick."""
THICKNESS = re.compile(r"\s*(diameter|radius)\s*(?:[\[(]\s*([^\])\s]*)\s*[\])])?\s*", re.IGNORECASE)
"""Regular expression for the name of a property or function that states the thickness, such as "diameter". The name can
include the unit, such as "radius [m]"."""


class Units:
    """Units of an RSML file.

    Parameters
    ----------
    path : Path
        Path of the file, used in messages.
    document : Element
        Root element of the file.
    """

    def __init__(self, path: Path, document: ET.Element) -> None:
        self.path = path
        self.document = document

    def step_mm(self, unit: str | None) -> float:
        """Return the length that corresponds to one unit of the coordinates, mm.

        Parameters
        ----------
        unit : str or None
            Unit given by the user; None for the unit stated in the file.

        Raises
        ------
        UserError
            If the unit is unknown or invalid.
        """
        if unit is not None:
            match = re.fullmatch(r"\s*([0-9][0-9.eE+-]*)?\s*(\S+)\s*", unit)
            if match is None:
                raise UserError(
                    f'{self.path}: the unit "{unit}" (--specimen-unit) must be mm, cm, m, um or inch, or a step such as "0.1 mm"'
                )
            size = self.number(match[1] or "1", "unit")
            if size <= 0.0:
                raise UserError(f'{self.path}: the unit "{unit}" (--specimen-unit) must have a size above 0')
            return size * self.unit_mm(match[2], "option --specimen-unit")
        written = self.metadata("unit")
        if not written:
            marked = {m[2] for e in self.document.iter() if (m := THICKNESS.fullmatch(rsml_xml.attribute(e, "name") or "")) and m[2]}
            if len(marked) == 1:  # "radius [m]": the only unit in the file is also used for its points
                return self.unit_mm(marked.pop(), "a function's name")
            raise UserError(f"{self.path}: the file states no unit; {_SET_UNIT}")
        pixel = _PIXEL.fullmatch(written)
        if pixel:
            size_text = next((text for key in _PIXEL_SIZES if (text := self.metadata(key))), "")
            if not pixel[1] or not size_text:
                raise UserError(f"{self.path}: the coordinates are in pixels, and the file does not state the size of a pixel; {_SET_UNIT}")
            size = self.number(size_text, "size of a pixel")
            if size <= 0.0:
                raise UserError(f"{self.path}: the file has pixels of {size_text} {pixel[1]}, which must be above 0; {_SET_UNIT}")
            return size * self.unit_mm(pixel[1], "size of a pixel")
        if written.lower() not in _UNITS_MM:
            raise UserError(f'{self.path}: the file has the unknown unit "{written}"; {_SET_UNIT}')
        unit_mm = _UNITS_MM[written.lower()]
        text = self.metadata("resolution")
        if not text and unit_mm == 25.4:
            raise UserError(f"{self.path}: the file has the unit inch but no resolution in dpi; {_SET_UNIT}")
        resolution = self.number(text or "1", "resolution")
        if resolution <= 0.0:
            raise UserError(f"{self.path}: the file has the resolution {text}, which must be above 0; {_SET_UNIT}")
        return unit_mm / resolution if resolution > 1.0 else unit_mm * resolution

    def properties_mm(self) -> dict[str, float]:
        """Return the units of all properties that are defined in the metadata with a unit of length.

        The keys are property names, and the values are the lengths of the units, mm.
        """
        found: dict[str, float] = {}
        for definition in self.document.iter():
            if rsml_xml.local_name(definition) == "property-definition":
                texts = {rsml_xml.local_name(child): (child.text or "").strip() for child in definition}
                if texts.get("unit", "").lower() in _UNITS_MM:
                    found[texts.get("label", "").lower()] = _UNITS_MM[texts["unit"].lower()]
        return found

    def metadata(self, key: str) -> str:
        """Return an entry of the metadata. It is empty if there is none."""
        for metadata in self.document:
            if rsml_xml.local_name(metadata) == "metadata":
                for child in metadata:
                    if rsml_xml.local_name(child) == key:
                        return (child.text or "").strip()
        return ""

    def unit_mm(self, name: str, what: str) -> float:
        """Return the length of a unit, mm.

        If the unit is unknown, the error message contains ``what``, the name of the quantity.
        """
        if name.lower() not in _UNITS_MM:
            raise UserError(f'{self.path}: the {what} has the unknown unit "{name}"; use mm, cm, m, um or inch')
        return _UNITS_MM[name.lower()]

    def number(self, text: str | None, what: str) -> float:
        """Parse a finite number. If it is invalid, the error message contains ``what``, the name of the quantity."""
        try:
            value = float(text or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise UserError(f'{self.path}: the {what} is "{text or ""}", which is not a finite number')
        return value


def is_thickness(diameter_mm: float) -> bool:
    """Return whether a mean diameter of roots is plausible, mm."""
    return THICKNESS_MM[0] <= diameter_mm <= THICKNESS_MM[1]


def doubt_unit(*, step_mm: float, unit: str, resolution: str, size_mm: float, diameter_mm: float) -> str | None:
    """Return a sentence if a root system has an implausible size, with a unit that makes it plausible.

    Parameters
    ----------
    step_mm : float
        Length that corresponds to one unit of the coordinates, mm.
    unit, resolution : str
        Unit and resolution that are stated in the file. They are empty if they are not used.
    size_mm : float
        Largest extent of the root system, mm.
    diameter_mm : float
        Mean diameter of the roots, weighted by length, mm.
    """

    def fits(factor: float) -> bool:
        return SIZE_MM[0] <= factor * size_mm <= SIZE_MM[1] and is_thickness(factor * diameter_mm)

    if fits(1.0):
        return None
    said = f"a root system of {_format_mm(size_mm)} with a mean root diameter of {_format_mm(diameter_mm)} is implausible"
    of_file_mm = {unit.lower(): _UNITS_MM[unit.lower()]} if unit.lower() in _UNITS_MM else {}
    if re.fullmatch(r"[0-9.]+", resolution) and float(resolution) > 1.0:
        of_file_mm[f"{25.4 / float(resolution):.4g} mm"] = 25.4 / float(resolution)  # dots per inch
    common_mm = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3}
    if SIZE_MM[0] <= size_mm <= SIZE_MM[1] and not any(fits(mm / step_mm) for mm in of_file_mm.values()):
        thick = {name: mm / step_mm * diameter_mm for name, mm in common_mm.items() if is_thickness(mm / step_mm * diameter_mm)}
        if thick:
            units = " or ".join(f"{name} ({_format_mm(value)})" for name, value in thick.items())
            return f'{said}. If the diameters are in {units}, state it in the name of their function, such as "diameter [cm]".'
    units_mm = {name: mm for name, mm in of_file_mm.items() if fits(mm / step_mm)} or {
        name: mm for name, mm in common_mm.items() if fits(mm / step_mm)
    }
    if units_mm:
        cures = " or ".join(
            f"--specimen-unit '{name}' ({_format_mm(mm / step_mm * size_mm)}, {_format_mm(mm / step_mm * diameter_mm)} thick)"
            for name, mm in units_mm.items()
        )
        return f"{said}. If the coordinates are in units of {' or '.join(units_mm)}, set {cures}, or correct the unit in the file."
    return f"{said}; check the unit of the coordinates and that of the diameters."


def _format_mm(value_mm: float) -> str:
    return f"{value_mm:.2g} mm" if value_mm < 100.0 else f"{value_mm:.0f} mm"
