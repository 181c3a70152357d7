"""Roots as polylines with diameters, and RSML files (Root System Markup Language).

Reference for RSML: Lobet et al. 2015, Plant Physiol. 167:617. Since many files deviate from the schema, they are read
as far as they can be interpreted. If the unit or the diameter is unknown, the error message states the option with
which it can be specified.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline, rsml_units, rsml_xml
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.plants import NAMELESS
from rhizotwin.scenes.rsml_units import Units

Array = NDArray[np.float64]

_TIP_SEEN = "tip-seen"
_SIGMA = "diameter-sigma"


@dataclass(frozen=True, kw_only=True, eq=False)
class Root:
    """Root of a plant, in the canister frame."""

    points_mm: Array
    """Points of the centre line, mm, shape (N, 3)."""
    diameters_mm: Array
    """Diameter at each point, mm, shape (N,)."""
    order: int
    parent: int
    """Index of the parent in the list of roots. It is -1 for a taproot."""
    label: str = ""
    tip_seen: bool = True
    """Whether the last point is the tip of the root. It is False if other roots hide the tip."""
    plant: str = ""
    """Name of the plant. It is empty for a single plant, or if the plant is unknown."""
    diameter_sigma_mm: Array | None = None
    """Standard deviation of the diameter at each point, mm, shape (N,). It is None if it is unknown."""


def length_mm(roots: Iterable[Root]) -> float:
    """Return the total length of roots, mm."""
    return float(sum(polyline.length_mm(root.points_mm) for root in roots))


def mean_diameter_mm(roots: Iterable[Root]) -> float:
    """Return the mean diameter of roots, weighted by length, mm. It is 0 if the roots have no length."""
    pieces = [(polyline.steps_mm(root.points_mm), 0.5 * (root.diameters_mm[:-1] + root.diameters_mm[1:])) for root in roots]
    total_mm = sum(float(steps.sum()) for steps, _ in pieces)
    return sum(float(steps @ diameters) for steps, diameters in pieces) / total_mm if total_mm > 0.0 else 0.0


def plant_roots(roots: Sequence[Root], plant: str) -> tuple[Root, ...]:
    """Return the roots of one plant. Their parents are indices into the returned roots.

    The parent is -1 if it belongs to another plant.
    """
    number = {index: place for place, index in enumerate(k for k, root in enumerate(roots) if root.plant == plant)}
    return tuple(replace(roots[index], parent=number.get(roots[index].parent, -1)) for index in number)


@dataclass(frozen=True, kw_only=True, eq=False)
class CentrePoints:
    """Points (P, 3) on the centre lines of roots. Each point is in the middle of a piece of a centre line."""

    points_mm: Array
    radius_mm: Array
    """Radius at each point, mm, shape (P,)."""
    length_mm: Array
    """Length of each piece, mm, shape (P,)."""
    root: NDArray[np.int64]
    """Index of the root to which each point belongs, shape (P,)."""


def sample_centre_lines(roots: Sequence[Root], step_mm: float) -> CentrePoints:
    """Sample points on the centre lines of at least one root.

    The points are about ``step_mm`` apart, with at least one point on each root.
    """
    points, radii, lengths = [], [], []
    for root in roots:
        way = polyline.arc_length_mm(root.points_mm)
        at = polyline.middles(way, step_mm)
        points.append(polyline.interpolate(root.points_mm, way, at))
        radii.append(np.interp(at, way, root.diameters_mm / 2.0))
        lengths.append(np.full(len(at), way[-1] / len(at)))
    return CentrePoints(
        points_mm=np.concatenate(points),
        radius_mm=np.concatenate(radii),
        length_mm=np.concatenate(lengths),
        root=np.repeat(np.arange(len(roots)), [len(one) for one in lengths]),
    )


@dataclass(frozen=True, kw_only=True)
class Moment:
    """Position of a file in a time series of a growing plant. A root has the same id in all files of the series."""

    sequence: str
    """Name of the time series to which the file belongs."""
    index: int
    """Time index, which is the day rounded to an integer."""


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
        interpreted as units per step (m with 0.0001: steps of 0.1 mm).
    diameter_mm : float or None
        Diameter of roots for which the file states none; None to reject such files.

    Returns
    -------
    tuple of Root
        Roots of all plants in the order of the file, parents before children, with the name of the plant if it has a
        label. Coordinates are the x, y, z of the file converted to mm, without rotation or translation. Points in 2-D
        (x, y), with y downwards as in a picture, become (x, 0, -y). Roots with fewer than two points are omitted, and
        their children are assigned to their parent.

    Raises
    ------
    UserError
        If the file cannot be read, is not RSML, or has no roots, or if its unit or diameters are unknown.
    """
    return read_file(path, unit=unit, diameter_mm=diameter_mm).roots


@dataclass(frozen=True, kw_only=True)
class RsmlFile:
    """Content of an RSML file, with its unit and the points of attachment."""

    roots: tuple[Root, ...]
    parent_nodes: tuple[int | None, ...]
    """Index of the parent's point to which each root is attached. It is None if the file does not state the index."""
    step_mm: float
    """Length that corresponds to one unit of the coordinates in the file, mm."""
    unit: str
    """Unit that is stated in the file. It is empty if none is stated."""
    resolution: str
    """Resolution that is stated in the file. It is empty if none is stated."""


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
        unit=reader.units.metadata("unit"),
        resolution=reader.units.metadata("resolution"),
    )


def write_rsml(
    path: Path | str, roots: tuple[Root, ...] | list[Root], *, modified: datetime | None = None, moment: Moment | None = None
) -> None:
    """Write roots, grouped by plant, to an RSML file with coordinates in mm. The file is written atomically.

    Numbers are written exactly, as decimals without exponents according to the schema. Each root has the property
    ``parent-node``, the index of the parent's point at which it is attached, which CPlantBox and OpenAlea read. The
    index is 0 for taproots, because both programs require a number for every root. Roots with hidden tips have the
    property ``tip-seen`` = false. Standard deviations of diameters are written as the function ``diameter-sigma``.
    `read_rsml` returns the roots in depth-first order.

    Parameters
    ----------
    path : path
        Path of the file.
    roots : tuple of Root or list of Root
        Roots, whose parents are indices into this sequence.
    modified : datetime or None
        Time for the metadata; None for the current time.
    moment : Moment or None
        Entry of a time series (a unified time sequence in RSML). In this case the labels of the roots are written as
        their ids.

    Raises
    ------
    ValueError
        If a parent is not in the list, or the parents form a cycle.
    UserError
        If the file cannot be written.
    """
    path = Path(path)
    document = ET.Element("rsml")
    _describe(document, path.stem, modified, moment)
    scene = ET.SubElement(document, "scene")
    names = list(dict.fromkeys(root.plant for root in roots if root.parent < 0)) or [""]
    plants = {name: ET.SubElement(scene, "plant", {"id": str(k), "label": name or NAMELESS}) for k, name in enumerate(names, start=1)}
    lost = [index for index, root in enumerate(roots) if not -1 <= root.parent < len(roots)]
    if lost:
        raise ValueError(f"root {lost[0]} has parent {roots[lost[0]].parent}, but there are {len(roots)} roots")
    elements = [_element(index, root, roots[root.parent] if root.parent >= 0 else None) for index, root in enumerate(roots)]
    for element, root in zip(elements, roots, strict=True):
        if moment is not None:
            element.set("id", root.label)
        (plants[root.plant] if root.parent < 0 else elements[root.parent]).append(element)
    if sum(1 for _ in scene.iter("root")) != len(roots):
        raise ValueError("the parents of some roots form a cycle")
    ET.indent(document, " ")
    write_bytes(path, ET.tostring(document, encoding="utf-8", xml_declaration=True) + b"\n")


def _describe(document: ET.Element, key: str, modified: datetime | None, moment: Moment | None) -> None:
    """Write the metadata of a document, including the definitions of its properties."""
    metadata = ET.SubElement(document, "metadata")
    when = (modified or datetime.now(UTC)).isoformat(timespec="seconds")
    entries = {"version": "1", "unit": "mm", "resolution": "1", "last-modified": when, "software": "rhizotwin", "user": ""}
    for name, text in {**entries, "file-key": key}.items():
        ET.SubElement(metadata, name).text = text
    if moment is not None:
        series = ET.SubElement(metadata, "time-sequence")
        for name, text in {"label": moment.sequence, "index": str(moment.index), "unified": "true"}.items():
            ET.SubElement(series, name).text = text
    definitions = ET.SubElement(metadata, "property-definitions")
    kinds = (("diameter", "real", "mm"), (_SIGMA, "real", "mm"), ("parent-node", "integer", ""), (_TIP_SEEN, "boolean", ""))
    for label, kind, unit in kinds:
        definition = ET.SubElement(definitions, "property-definition")
        for name, text in {"label": label, "type": kind, "unit": unit}.items():
            ET.SubElement(definition, name).text = text


def _element(index: int, root: Root, parent: Root | None) -> ET.Element:
    """Return the XML element of a root, without the elements of its laterals."""
    if root.points_mm.ndim != 2 or root.points_mm.shape[1] != 3 or root.diameters_mm.shape != root.points_mm.shape[:1]:
        raise ValueError(f"{root.points_mm.shape=} {root.diameters_mm.shape=} but shapes (N, 3) and (N,) are required")
    element = ET.Element("root", {"id": f"1.{index + 1}", "label": root.label})
    node = 0 if parent is None else int(np.argmin(np.sum((parent.points_mm - root.points_mm[0]) ** 2, axis=1)))
    properties = ET.SubElement(element, "properties")
    ET.SubElement(properties, "parent-node", {"value": str(node)})
    if not root.tip_seen:
        ET.SubElement(properties, _TIP_SEEN, {"value": "false"})
    polyline = ET.SubElement(ET.SubElement(element, "geometry"), "polyline")
    for point in root.points_mm:
        ET.SubElement(polyline, "point", dict(zip("xyz", map(_decimal, point), strict=True)))
    functions = ET.SubElement(element, "functions")
    for name, values in (("diameter", root.diameters_mm), (_SIGMA, root.diameter_sigma_mm)):
        if values is not None:
            function = ET.SubElement(functions, "function", {"name": name, "domain": "polyline"})
            for value in values:
                ET.SubElement(function, "sample", {"value": _decimal(value)})
    return element


def _decimal(value: np.floating) -> str:
    """Format a number without an exponent. The text is the shortest from which the same number is read."""
    return np.format_float_positional(value, trim="0")


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

    def roots(self) -> tuple[Root, ...]:
        """Return the roots. Parents precede their laterals."""
        found: list[Root] = []
        stack: list[tuple[ET.Element, int, str]] = [(self.document, -1, "")]
        number = 0
        while stack:
            element, parent, plant = stack.pop()
            below = parent
            if rsml_xml.local_name(element) == "plant":
                plant = rsml_xml.attribute(element, "label") or ""
                plant = "" if plant == NAMELESS else plant
            if rsml_xml.local_name(element) == "root":
                number += 1
                order = found[parent].order + 1 if parent >= 0 else 0
                root = self._root(element, f"root {number}", order, parent, plant)
                if root is not None:
                    below = len(found)
                    found.append(root)
                    node = rsml_xml.read_property(list(rsml_xml.own_elements(element)), "parent-node")
                    self.parent_nodes.append(int(node) if node.isdecimal() else None)
            stack.extend((child, below, plant) for child in reversed(element))
        if not found:
            raise UserError(f"{self.path}: the file contains no root with at least two points")
        return tuple(found)

    def _root(self, element: ET.Element, name: str, order: int, parent: int, plant: str) -> Root | None:
        label = rsml_xml.attribute(element, "label") or ""
        name = f'{name} ("{label}")' if label else name
        own = list(rsml_xml.own_elements(element))
        polylines = [p for p in own if rsml_xml.local_name(p) == "polyline" and any(rsml_xml.local_name(q) == "point" for q in p)]
        if not polylines:
            return None
        if len(polylines) > 1:
            raise UserError(f"{self.path}: {name} has {len(polylines)} polylines, but a root must have exactly one")
        points = [p for p in polylines[0] if rsml_xml.local_name(p) == "point"]
        if len(points) < 2:
            return None
        axes = "xyz" if rsml_xml.attribute(points[0], "z") is not None else "xy"
        number = self.units.number
        given = np.array([[number(rsml_xml.attribute(p, axis), f"{axis} of a point of {name}") for axis in axes] for p in points])
        xyz = given if axes == "xyz" else np.stack([given[:, 0], np.zeros(len(given)), -given[:, 1]], axis=1)
        points_mm = xyz * self.step_mm
        diameters_mm = self._diameters(own, points_mm, name)
        seen = (rsml_xml.read_property(own, _TIP_SEEN) or "").lower() not in ("false", "0")
        return Root(
            points_mm=points_mm,
            diameters_mm=diameters_mm,
            order=order,
            parent=parent,
            label=label,
            tip_seen=seen,
            plant=plant,
            diameter_sigma_mm=self._sigma(own, points_mm, name),
        )

    def _sigma(self, own: list[ET.Element], points_mm: Array, name: str) -> Array | None:
        """Return the standard deviations of the diameters of a root (N,), mm, or None if the file states none."""
        for written, element, samples in _functions(own):
            if written == _SIGMA:
                return np.abs(self._along(element, samples, points_mm, f"{_SIGMA} of {name}")) * self.step_mm
        return None

    def _diameters(self, own: list[ET.Element], points_mm: Array, name: str) -> Array:
        """Return the diameters of a root (N,), mm.

        They are read from a function along the root or, if there is none, from a property of the root. Otherwise, the
        diameter given by the user is used.
        """
        for word in ("diameter", "radius"):
            to_diameter = 1.0 if word == "diameter" else 2.0
            for written, element, samples in _functions(own):
                match = rsml_units.THICKNESS.fullmatch(written)
                if match is None or match[1].lower() != word:
                    continue
                scale_mm = to_diameter * (self.units.unit_mm(match[2], f"function of {name}") if match[2] else self.step_mm)
                return self._check_diameters(self._along(element, samples, points_mm, f"{word} of {name}") * scale_mm, name)
            text = rsml_xml.read_property(own, word)
            if text:
                value = self.units.number(text, f"{word} of {name}")
                scale_mm = to_diameter * self.property_mm.get(word, self.step_mm)
                return self._check_diameters(np.full(len(points_mm), value * scale_mm), name)
        if self.diameter_mm is None:
            raise UserError(
                f"{self.path}: {name} has no diameter; specify a diameter with --specimen-diameter-mm D, or with diameter_mm in a scene "
                "file"
            )
        return np.full(len(points_mm), self.diameter_mm)

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
