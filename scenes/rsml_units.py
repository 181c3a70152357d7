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
_SET_UNIT = "give the size of one coordinate unit, such as '0.1 mm', with --specimen-unit, or as unit in a scene file"
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
