"""Reader of RSML files (Root System Markup Language).

Since many files deviate from the schema, they are read as far as they can be interpreted. If the unit or the diameter
is unknown, the error message states the option with which it can be specified.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rhizotwin.scenes import polyline, rsml_hierarchy, rsml_units, rsml_xml
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import DIAMETER_SIGMA, TIP_SEEN, Array, Root, mean_diameter_mm
from rhizotwin.scenes.rsml_hierarchy import Entry
from rhizotwin.scenes.rsml_units import Units


def read_rsml(path: Path | str, *, unit: str | None = None, diameter_mm: float | None = None) -> tuple[Root, ...]:
    """Read the roots of an RSML file.

    Parameters
    ----------
    path : path
        Path of the file.
    unit : str or None
        Unit of the coordinates, and of diameters without a unit: mm, cm, m, um or inch, or a number and one of these
        units for the size of one step, as in ``0.1 mm``. None for the unit stated in the file. If the file states a
        resolution above 1, it is interpreted as steps per unit (inch with 300: 300 dpi). If it is below 1, it is
        interpreted as units per step (m with 0.0001: steps of 0.1 mm). With pixel(um), the size of a pixel is read.
    diameter_mm : float or None
        Diameter of roots for which the file states none; None to reject such files.

    Returns
    -------
    tuple of Root
        Roots of all plants in the order of the file, parents before children, with the name of the plant if it has a
        label. Coordinates are the x, y, z of the file converted to mm, without rotation or translation. Points in 2-D
        (x, y), with y downwards as in a picture, become (x, 0, -y). Roots that are not nested in their parents can
        state the parent's id. A single point is connected to the stated node of the parent. Otherwise, roots with fewer
        than two points are omitted, and their children are assigned to their parent.

    Raises
    ------
    UserError
        If the file cannot be read, is not RSML, or has no roots, or if its unit, diameters or a stated parent are
        unknown.
    """
    return read_file(path, unit=unit, diameter_mm=diameter_mm).roots


@dataclass(frozen=True, kw_only=True)
class RsmlFile:
    """Content of an RSML file, with its unit and the points of attachment."""

    roots: tuple[Root, ...]
    parent_nodes: tuple[int | None, ...]
    """Index (from 0) of the parent's point to which each root is attached. It is None if the file states none."""
    step_mm: float
    """Length that corresponds to one unit of the coordinates in the file, mm."""
    unit: str
    """Unit that is stated in the file. It is empty if none is stated, or if another unit was given."""
    resolution: str
    """Resolution that is stated in the file. It is empty if none is stated, or if another unit was given."""
    dimensions: int = 3
    """Number of coordinates of the points in the file, 2 or 3."""
    notes: tuple[str, ...] = ()
    """Sentences on how the file was interpreted."""

    def doubt_unit(self, roots: Sequence[Root], points_mm: Array) -> str | None:
        """Return a sentence if the thickness of roots, or the extent of their points (N, 3), mm, is implausible."""
        sizes_mm = {"size_mm": float(np.ptp(points_mm, axis=0).max()), "diameter_mm": mean_diameter_mm(roots)}
        return rsml_units.doubt_unit(step_mm=self.step_mm, unit=self.unit, resolution=self.resolution, **sizes_mm)


def read_file(path: Path | str, *, unit: str | None = None, diameter_mm: float | None = None) -> RsmlFile:
    """Read an RSML file.

    In addition to the result of `read_rsml`, information about the roots and the unit is returned.

    Parameters
    ----------
    path : Path or str
        Path of the file.
    unit : str or None
        Unit of the coordinates; None for the unit stated in the file.
    diameter_mm : float or None
        Diameter of roots for which the file states none; None to reject such files.

    Returns
    -------
    RsmlFile
        Roots with their parents, and the file's unit and resolution.
    """
    reader = _Reader(Path(path), unit, diameter_mm)
    roots = reader.roots()
    return RsmlFile(
        roots=roots,
        parent_nodes=tuple(reader.parent_nodes),
        step_mm=reader.step_mm,
        unit="" if unit else reader.units.metadata("unit"),
        resolution="" if unit else reader.units.metadata("resolution"),
        dimensions=reader.dimensions,
        notes=tuple(reader.notes),
    )


def _functions(own: Iterable[ET.Element]) -> Iterator[tuple[str, ET.Element, list[ET.Element]]]:
    """Yield the name, the element and the samples of each function along a root.

    The elements of the root are given without those of its laterals.
    """
    for element in own:
        samples = [child for child in element if rsml_xml.local_name(child) == "sample"]
        if rsml_xml.local_name(element).startswith("function") and samples:
            yield rsml_xml.attribute(element, "name") or "", element, samples


class _Reader:
    """Reader of an RSML file."""

    def __init__(self, path: Path, unit: str | None, diameter_mm: float | None) -> None:
        self.path = path
        self.diameter_mm = diameter_mm
        self.parent_nodes: list[int | None] = []
        self.document = rsml_xml.parse(path)
        if rsml_xml.local_name(self.document) != "rsml":
            raise UserError(
                f"{path}: the file is not an RSML file, because its outermost element is <{self.document.tag}> instead of <rsml>"
            )
        self.units = Units(path, self.document)
        self.step_mm = self.units.step_mm(unit)
        self.property_mm = self.units.properties_mm()
        self._functions_mm: dict[str, float] = {}
        self.dimensions = 2
        self.notes: list[str] = []

    def roots(self) -> tuple[Root, ...]:
        """Return the roots. Parents precede their laterals."""
        entries = rsml_hierarchy.list_entries(self.document)
        for entry in entries:
            entry.root = self._root(entry)
        parents = rsml_hierarchy.find_parents(self.path, entries)
        nodes = rsml_hierarchy.resolve_parent_nodes(entries, parents)
        found: list[Root] = []
        extended = [False] * len(entries)
        above: dict[int, int] = {-1: -1}  # index in ``found`` of each entry or, if it has no line, of its parent
        for index in rsml_hierarchy.parents_first(self.path, entries, parents):
            entry, parent = entries[index], above[parents[index]]
            above[index] = parent
            node = nodes[index]
            node = None if node is None else node + extended[parents[index]]
            if entry.root is None and node is not None and entries[parents[index]].root is not None:
                entry.root = self._root(entry, found[parent].points_mm[node])
                extended[index] = entry.root is not None
            if entry.root is not None:
                above[index] = len(found)
                found.append(replace(entry.root, parent=parent, order=found[parent].order + 1 if parent >= 0 else 0))
                self.parent_nodes.append(node)
        if any(extended):
            self.notes.append(f"{self.path}: {sum(extended)} roots with a single point were connected to nodes of their parents.")
        if not found:
            raise UserError(f"{self.path}: the file contains no root with at least two points")
        return tuple(found)

    def _root(self, entry: Entry, attached_mm: Array | None = None) -> Root | None:
        """Return the root of an element without its parent, or None if it has no line.

        A single point becomes a line if the point (3,) of the parent to which it is attached is given, mm. CPlantBox
        2.1.1 omits the first point of laterals, which it states as the property ``parent-node``.
        """
        own, name = entry.own, entry.name
        polylines = [p for p in own if rsml_xml.local_name(p) == "polyline" and any(rsml_xml.local_name(q) == "point" for q in p)]
        if not polylines:
            return None
        if len(polylines) > 1:
            raise UserError(f"{self.path}: {name} has {len(polylines)} polylines, but a root must have exactly one")
        points = [p for p in polylines[0] if rsml_xml.local_name(p) == "point"]
        prefix = "" if rsml_xml.attribute(points[0], "coord_x") is None else "coord_"  # of RootSystemTracker
        axes = "xyz" if rsml_xml.attribute(points[0], prefix + "z") is not None else "xy"
        self.dimensions = max(self.dimensions, len(axes))
        number = self.units.number
        given = np.array([[number(rsml_xml.attribute(p, prefix + axis), f"{axis} of a point of {name}") for axis in axes] for p in points])
        xyz = given if axes == "xyz" else np.stack([given[:, 0], np.zeros(len(given)), -given[:, 1]], axis=1)
        points_mm = entry.points_mm = xyz * self.step_mm
        text = rsml_xml.read_property(own, "parent-node").removesuffix(".0")
        entry.parent_node = int(text) if text.isdecimal() else None
        if len(points_mm) < 2:
            if attached_mm is None:
                return None
            points_mm = np.concatenate([attached_mm[None], points_mm])
        return Root(
            points_mm=points_mm,
            diameters_mm=self._diameters(own, points, points_mm, name),
            order=0,
            parent=-1,
            label=entry.label,
            tip_seen=rsml_xml.read_property(own, TIP_SEEN).lower() not in ("false", "0"),
            plant=entry.plant_name,
            diameter_sigma_mm=self._sigma(own, points_mm, name),
        )

    def _sigma(self, own: list[ET.Element], points_mm: Array, name: str) -> Array | None:
        """Return the standard deviations of the diameters of a root (N,), mm, or None if the file states none."""
        for written, element, samples in _functions(own):
            if written == DIAMETER_SIGMA:
                return np.abs(self._along(element, samples, points_mm, f"{DIAMETER_SIGMA} of {name}")) * self.step_mm
        return None

    def _diameters(self, own: list[ET.Element], points: list[ET.Element], points_mm: Array, name: str) -> Array:
        """Return the diameters of a root (N,), mm.

        They are read from a function along the root or, if there is none, from a property of the root or from the
        points. Otherwise, the diameter given by the user is used.
        """
        for word in ("diameter", "radius"):
            to_diameter = 1.0 if word == "diameter" else 2.0
            for written, element, samples in _functions(own):
                match = rsml_units.THICKNESS.fullmatch(written)
                if match is None or match[1].lower() != word:
                    continue
                scale_mm = to_diameter * (self.units.unit_mm(match[2], f"function of {name}") if match[2] else self._function_mm(word))
                return self._check_diameters(self._along(element, samples, points_mm, f"{word} of {name}") * scale_mm, name)
            text = rsml_xml.read_property(own, word)
            if text:
                value = self.units.number(text, f"{word} of {name}")
                scale_mm = to_diameter * self.property_mm.get(word, self.step_mm)
                return self._check_diameters(np.full(len(points_mm), value * scale_mm), name)
        of_points = [rsml_xml.attribute(point, "diameter") for point in points]
        if None not in of_points:
            values = np.array([self.units.number(text, f"diameter of a point of {name}") for text in of_points])
            if np.median(values) > 0.0:  # RootSystemTracker (4679932) writes 0 if it did not measure the diameter
                return self._check_diameters(np.resize(values, len(points_mm)) * self.step_mm, name)
        if self.diameter_mm is None:
            raise UserError(
                f"{self.path}: {name} has no diameter; specify a diameter with --specimen-diameter-mm D, or with diameter_mm in a scene "
                "file"
            )
        return np.full(len(points_mm), self.diameter_mm)

    def _function_mm(self, word: str) -> float:
        """Return the unit of a function along the root whose name states none, mm.

        It is the unit of the coordinates, which SmartRoot uses although it defines a property of the same name in cm.
        If that makes implausible roots, it is the unit of this definition.
        """
        defined_mm = self.property_mm.get(word)
        if defined_mm is None:
            return self.step_mm
        if word not in self._functions_mm:
            samples = [s for name, _, part in _functions(self.document.iter()) if name.strip().lower() == word for s in part]
            values = [self.units.number(rsml_xml.attribute(s, "value") or s.text, f"{word} of a root") for s in samples]
            median = float(np.median(values)) * (1.0 if word == "diameter" else 2.0)
            defined_fits = rsml_units.is_thickness(median * defined_mm) and not rsml_units.is_thickness(median * self.step_mm)
            self._functions_mm[word] = defined_mm if defined_fits else self.step_mm
            if defined_fits:
                self.notes.append(
                    f"{self.path}: the {word} of the roots is read in the unit of its definition in the file, because a median "
                    f"diameter of {median * self.step_mm:.2g} mm in the unit of the coordinates is implausible."
                )
        return self._functions_mm[word]

    def _along(self, function: ET.Element, samples: list[ET.Element], points_mm: Array, what: str) -> Array:
        """Return the values of a function at the points of a root (N,).

        They are interpolated along the root if the function does not have one value per point.
        """
        values = np.array([self.units.number(rsml_xml.attribute(s, "value") or s.text, what) for s in samples])
        positions = [rsml_xml.attribute(s, "position") for s in samples]
        by_point = (rsml_xml.attribute(function, "domain") or "").lower() == "polyline"
        if len(values) == len(points_mm) and (by_point or None in positions):
            return values
        if len(values) == 1:
            return np.full(len(points_mm), values[0])
        if by_point:
            raise UserError(
                f"{self.path}: {what} has {len(values)} samples for {len(points_mm)} points, but must have one sample per point"
            )
        way_mm = polyline.arc_length_mm(points_mm)
        if None in positions:
            at_mm = np.linspace(0.0, way_mm[-1], len(values))
        else:
            at_mm = np.array([self.units.number(position, f"position in {what}") for position in positions]) * self.step_mm
            if np.any(np.diff(at_mm) < 0.0):
                raise UserError(f"{self.path}: the positions of {what} do not increase")
        along: Array = np.interp(way_mm, at_mm, values)
        return along

    def _check_diameters(self, diameters_mm: Array, name: str) -> Array:
        if diameters_mm.min() < 0.0 or diameters_mm.max() == 0.0:
            raise UserError(f"{self.path}: {name} has a diameter of {diameters_mm.min():g} mm; diameters must be above 0")
        return diameters_mm
