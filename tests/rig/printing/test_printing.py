"""What is printed, drawn at 300 dpi and measured; and the size of the written pages."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from rhizotwin.rig.printing.print_board import board_page
from rhizotwin.rig.printing.print_files import to_figure, write_pages
from rhizotwin.rig.printing.print_page import PAGES_MM, Line, Page, Paper
from rhizotwin.rig.printing.print_strip import strip_pages
from rhizotwin.scenes.board import CharucoBoard, opencv_board
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.markers import get_dictionary, strip_ids
from rhizotwin.scenes.model import MarkerStrip, NetPot, Scene

DPI = 300
PX_PER_MM = DPI / 25.4
SCENE = Scene()


def drawn(page: Page, dpi: int = DPI) -> NDArray[np.uint8]:
    """Return the page as a printer would put it on paper, grey."""
    canvas = FigureCanvasAgg(to_figure(page))
    canvas.figure.set_dpi(dpi)
    canvas.draw()
    return np.asarray(cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2GRAY), np.uint8)


def edge_mm(row: NDArray[np.float64], *, rising: bool) -> float:
    """Return where a row of grey levels crosses the middle between black and white, in mm from its beginning."""
    middle = (row.max() + row.min()) / 2.0
    k = int(np.flatnonzero((row[:-1] < middle) & (row[1:] >= middle) if rising else (row[:-1] > middle) & (row[1:] <= middle))[0])
    return (k + 1.0 + (middle - row[k]) / (row[k + 1] - row[k]) - 0.5) / PX_PER_MM


def found_markers(picture: NDArray[np.uint8], dictionary: str = "APRILTAG_36h11") -> dict[int, NDArray[np.float64]]:
    """Return the markers of a dictionary by id, corners (4, 2) in mm from the page's top left corner."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG  # returns corners with the pixel's edge at integers
    corners, ids, _ = cv2.aruco.ArucoDetector(get_dictionary(dictionary), parameters).detectMarkers(picture)
    assert ids is not None
    assert len(set(np.ravel(ids).tolist())) == len(np.ravel(ids)), "a marker was found twice"
    return {int(k): np.asarray(c, np.float64).reshape(4, 2) / PX_PER_MM for k, c in zip(np.ravel(ids), corners, strict=True)}


@pytest.fixture(scope="module")
def strip_drawn() -> NDArray[np.uint8]:
    (page,) = strip_pages(SCENE, paper=Paper(), paper_mm=0.0)
    return drawn(page)


def test_every_marker_has_its_place_and_size(strip_drawn: NDArray[np.uint8]) -> None:
    strip_found = found_markers(strip_drawn)
    assert sorted(strip_found) == list(range(62))
    for top_left, top_right, _, bottom_left in strip_found.values():
        assert top_left[0] < top_right[0]
        assert top_left[1] < bottom_left[1]
    middles = {k: corners.mean(axis=0) for k, corners in strip_found.items()}
    reading = sorted(range(31), key=lambda k: (round(middles[k][1] / 20.0), middles[k][0]))
    assert reading == list(range(31))
    for k in range(31):
        np.testing.assert_allclose(middles[k + 31] - middles[k], [0.0, 16.5], atol=0.05)
    pitch_mm = 2.0 * np.pi * 79.6 / 31
    for corners in strip_found.values():
        np.testing.assert_allclose(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1), 13.0, atol=0.05)
    for first, last in ((0, 15), (16, 30)):  # the two pieces of the strip on an A4 page
        along = np.array([strip_found[k].mean(axis=0)[0] for k in range(first, last + 1)])
        np.testing.assert_allclose(along - along[0], pitch_mm * np.arange(last - first + 1), atol=0.05)


def test_thick_paper_is_drawn_shorter_by_what_bending_stretches() -> None:
    """On a strip that has no room for the ids of the markers, which must not touch them."""
    tight = replace(SCENE, net_pot=replace(NetPot(), top_mm=27.0), strip=MarkerStrip())
    found = found_markers(drawn(strip_pages(tight, paper=Paper(), paper_mm=1.0)[0]))
    assert sorted(found) == list(range(62))
    along_mm = found[15].mean(axis=0) - found[0].mean(axis=0)
    np.testing.assert_allclose(along_mm, [15 * 2.0 * np.pi * (79.6 - 0.5) / 31, 0.0], atol=0.05)


def test_pieces_of_several_pages_hold_every_column_once() -> None:
    strip = MarkerStrip(dictionary="APRILTAG_36h10", first_id=199 * 62)  # of canister 200, which is coded
    pages = strip_pages(replace(SCENE, strip=strip), paper=Paper(size_mm=(200.0, 140.0)), paper_mm=0.0)
    assert len(pages) > 2
    ids = [k for page in pages for k in found_markers(drawn(page, dpi=150), strip.dictionary)]
    assert sorted(ids) == sorted(strip_ids(strip).ravel())


def test_the_ruler_and_the_square_come_out_right() -> None:
    """Of a printer that makes 99 mm of 100 across and 98.5 down."""
    paper, came_out = Paper(size_mm=PAGES_MM["a4"], printed_ruler_mm=(99.0, 98.5)), np.array([0.99, 0.985])
    page = strip_pages(SCENE, paper=paper)[0]
    ticks = [part for part in page.parts if isinstance(part, Line) and part.to_mm[1] - part.from_mm[1] == 5.0]
    assert ticks[-1].from_mm[0] - ticks[0].from_mm[0] == pytest.approx(100.0)
    stretch, on_paper = np.array(page.stretch_xy), drawn(page).astype(float)
    left_mm, top_mm = paper.corner_mm()
    square_top_mm = top_mm + paper.room_mm(page.size_mm)[1] - 50.0
    row = on_paper[round((square_top_mm + 10.0) * stretch[1] * PX_PER_MM)]
    row = row[: round((left_mm + 55.0) * stretch[0] * PX_PER_MM)]
    column = on_paper[:, round((left_mm + 10.0) * stretch[0] * PX_PER_MM)][round((square_top_mm - 5.0) * stretch[1] * PX_PER_MM) :]
    assert (edge_mm(row, rising=True) - edge_mm(row, rising=False)) * came_out[0] == pytest.approx(50.0, abs=0.05)
    assert (edge_mm(column, rising=True) - edge_mm(column, rising=False)) * came_out[1] == pytest.approx(50.0, abs=0.05)


def test_the_board_is_opencvs_and_never_taken_for_the_strip(strip_drawn: NDArray[np.uint8]) -> None:
    board = CharucoBoard()
    board_drawn = drawn(board_page(board, paper=Paper()))
    corners, ids, _, markers = cv2.aruco.CharucoDetector(opencv_board(board)).detectBoard(board_drawn)
    assert sorted(np.ravel(ids)) == list(range(24))
    assert sorted(np.ravel(markers)) == list(range(17))
    at_mm = (np.reshape(corners, (-1, 2)) + 0.5) / PX_PER_MM - 10.0
    np.testing.assert_allclose(at_mm, board.corners_mm[np.ravel(ids), :2], atol=0.05)
    for dictionary, picture in ((cv2.aruco.DICT_APRILTAG_36h11, board_drawn), (cv2.aruco.DICT_5X5_100, strip_drawn)):
        assert cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary)).detectMarkers(picture)[1] is None


def test_pdf_pages_have_the_size_and_ask_not_to_be_scaled(tmp_path: Path) -> None:
    pages = strip_pages(SCENE, paper=Paper(size_mm=(200.0, 140.0)))
    with plt.rc_context({"savefig.bbox": "tight", "savefig.dpi": 30}):  # a user's settings do not matter
        (path,) = write_pages(pages, tmp_path / "strip.pdf", title="strip")
    pdf = path.read_bytes()
    boxes = re.findall(rb"/MediaBox \[\s*0 0 ([0-9.]+) ([0-9.]+)\s*\]", pdf)
    assert len(boxes) == len(pages)
    np.testing.assert_allclose(np.array(boxes, float) * 25.4 / 72.0, [(200.0, 140.0)] * len(pages), atol=1e-4)
    table = int(re.findall(rb"startxref\s+(\d+)", pdf)[-1])
    offset = int(re.match(rb"xref\n0 1\n.{20}\d+ 1\n(\d{10}) 00000 n", pdf[table:], re.DOTALL)[1])
    assert re.match(rb"\d+ 0 obj\s*<<[^>]*/Type /Catalog.*/PrintScaling /None", pdf[offset:], re.DOTALL)


def test_svg_pages_are_numbered_and_have_the_paper_s_size(tmp_path: Path) -> None:
    paths = write_pages(strip_pages(SCENE, paper=Paper(size_mm=(200.0, 140.0))), tmp_path / "strip.svg", title="strip")
    assert [path.name for path in paths] == [f"strip-{k + 1}.svg" for k in range(len(paths))]
    assert 'width="200mm" height="140mm"' in paths[0].read_text(encoding="utf-8")


def test_what_does_not_fit_is_refused_with_the_sizes() -> None:
    with pytest.raises(UserError, match="too small for the strip"):
        strip_pages(SCENE, paper=Paper(size_mm=(120.0, 100.0)))
    with pytest.raises(UserError, match="420 x 300 mm, with its ruler, does not fit"):
        board_page(CharucoBoard(square_mm=60.0), paper=Paper())
