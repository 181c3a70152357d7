"""Roots as polylines with diameters, as in RSML (Root System Markup Language), and their storage in RSML files.

Reference for RSML: Lobet et al. 2015, Plant Physiol. 167:617. The files are read by `scenes.rsml_reader`.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.plants import NAMELESS

Array = NDArray[np.float64]

TIP_SEEN = "tip-seen"
"""Property of a root in RSML files: 1 if its last point is its tip, otherwise 0."""
DIAMETER_SIGMA = "diameter-sigma"
"""Function along a root in RSML files: standard deviation of its diameter."""


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


def write_rsml(
    path: Path | str, roots: tuple[Root, ...] | list[Root], *, modified: datetime | None = None, moment: Moment | None = None
) -> None:
    """Write roots, grouped by plant, to an RSML file with coordinates in mm. The file is written atomically.

    Numbers are written exactly, as decimals without exponents according to the schema. Each root has the property
    ``parent-node``, the index of the parent's point at which it is attached, and ``tip-seen``, which is 0 if the tip is
    hidden and otherwise 1. Every root has both, because CPlantBox 2.1.1 reads a property as a list without gaps, and
    ``tip-seen`` is a number, because OpenAlea (RSML 7ffc35b) reads properties as Python literals. The ``parent-node``
    of taproots is 0, see docs/datasets.md. Standard deviations of diameters are written as the function
    ``diameter-sigma``. `scenes.rsml_reader.read_rsml` returns the roots in depth-first order.

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
    kinds = (("diameter", "real", "mm"), (DIAMETER_SIGMA, "real", "mm"), ("parent-node", "integer", ""), (TIP_SEEN, "boolean", ""))
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
    ET.SubElement(properties, TIP_SEEN, {"value": str(int(root.tip_seen))})
    polyline = ET.SubElement(ET.SubElement(element, "geometry"), "polyline")
    for point in root.points_mm:
        ET.SubElement(polyline, "point", dict(zip("xyz", map(_decimal, point), strict=True)))
    functions = ET.SubElement(element, "functions")
    for name, values in (("diameter", root.diameters_mm), (DIAMETER_SIGMA, root.diameter_sigma_mm)):
        if values is not None:
            function = ET.SubElement(functions, "function", {"name": name, "domain": "polyline"})
            for value in values:
                ET.SubElement(function, "sample", {"value": _decimal(value)})
    return element


def _decimal(value: np.floating) -> str:
    """Format a number without an exponent. The text is the shortest from which the same number is read."""
    return np.format_float_positional(value, trim="0")
