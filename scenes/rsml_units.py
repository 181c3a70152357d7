"""Units of an RSML file: the size of a step of its coordinates, and the units of properties and functions."""

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
_SET_UNIT = "set it with --specimen-unit UNIT, or as unit in a scene file"
THICKNESS = re.compile(r"\s*(diameter|radius)\s*(?:[\[(]\s*([^\])\s]*)\s*[\])])?\s*", re.IGNORECASE)
"""Name of a property or function of the thickness, optionally with its unit: "diameter", "radius [m]"."""


class Units:
    """Units of one RSML file.

    Parameters
    ----------
    path : Path
        Path, used in messages.
    document : Element
        Content of the file.
    """

    def __init__(self, path: Path, document: ET.Element) -> None:
        self.path = path
        self.document = document

    def step_mm(self, unit: str | None) -> float:
        """Return the size of one step of the coordinates, mm.

        Parameters
        ----------
        unit : str or None
            Unit given by the user; None for the one stated in the file.

        Raises
        ------
        UserError
            If neither is known.
        """
        if unit is not None:
            match = re.fullmatch(r"\s*([0-9][0-9.eE+-]*)?\s*(\S+)\s*", unit)
            if match is None:
                raise UserError(
                    f'{self.path}: the unit "{unit}" (--specimen-unit) must be mm, cm, m, um or inch, or a step such as "0.1 mm"'
                )
            size = self.number(match[1] or "1", "unit")
            if size <= 0.0:
                raise UserError(f'{self.path}: the unit "{unit}" (--specimen-unit) must be above 0')
            return size * self.unit_mm(match[2], "option --specimen-unit")
        written = self.metadata("unit")
        if not written:
            marked = {m[2] for e in self.document.iter() if (m := THICKNESS.fullmatch(rsml_xml.attribute(e, "name") or "")) and m[2]}
            if len(marked) == 1:  # "radius [m]": the only unit in the file is also used for its points
                return self.unit_mm(marked.pop(), "a function's name")
            raise UserError(f"{self.path}: names no unit; {_SET_UNIT}: mm, cm, m, um or inch, or a step such as 0.1 mm")
        if written.lower() not in _UNITS_MM:
            raise UserError(f'{self.path}: has the unit "{written}", whose size is unknown; {_SET_UNIT}, as the size of one such as 0.1 mm')
        unit_mm = _UNITS_MM[written.lower()]
        text = self.metadata("resolution")
        if not text and unit_mm == 25.4:
            raise UserError(
                f"{self.path}: has the unit inch without a resolution in dpi; {_SET_UNIT}, as the size of a step such as 0.1 mm"
            )
        resolution = self.number(text or "1", "resolution")
        if resolution <= 0.0:
            raise UserError(
                f"{self.path}: has the resolution {text}; it must be above 0; {_SET_UNIT}, as the size of a step such as 0.1 mm"
            )
        return unit_mm / resolution if resolution > 1.0 else unit_mm * resolution

    def properties_mm(self) -> dict[str, float]:
        """Return the size in mm of the units of the properties that the metadata define with a unit of length."""
        found: dict[str, float] = {}
        for definition in self.document.iter():
            if rsml_xml.local_name(definition) == "property-definition":
                texts = {rsml_xml.local_name(child): (child.text or "").strip() for child in definition}
                if texts.get("unit", "").lower() in _UNITS_MM:
                    found[texts.get("label", "").lower()] = _UNITS_MM[texts["unit"].lower()]
        return found

    def metadata(self, key: str) -> str:
        """Return an entry of the metadata, empty if there is none."""
        for metadata in self.document:
            if rsml_xml.local_name(metadata) == "metadata":
                for child in metadata:
                    if rsml_xml.local_name(child) == key:
                        return (child.text or "").strip()
        return ""

    def unit_mm(self, name: str, what: str) -> float:
        """Return the size of a unit in mm; ``what`` names the quantity in the message for an unknown unit."""
        if name.lower() not in _UNITS_MM:
            raise UserError(f'{self.path}: the {what} has the unknown unit "{name}"; use mm, cm, m, um or inch')
        return _UNITS_MM[name.lower()]

    def number(self, text: str | None, what: str) -> float:
        """Return a finite number; ``what`` names the quantity in the message for an invalid one."""
        try:
            value = float(text or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise UserError(f'{self.path}: the {what} is "{text or ""}", which is not a finite number')
        return value
