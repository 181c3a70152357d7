"""The lens from pictures of the board: corners, fit, what is refused, and the twin's pictures; a camera's curve from exposures."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.lens.board_corners import BoardView, NoBoard, find_board
from rhizotwin.rig.lens.calibration import calibrate, calibrate_views
from rhizotwin.rig.lens.calibration_report import write_report
from rhizotwin.rig.lens.lens_fit import fit_lens
from rhizotwin.rig.lens.transfer_fit import fit_transfer
from rhizotwin.rig.lens.transfer_series import read_series
from rhizotwin.rig.twin.raw_file import encode_dng
from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.board import CharucoBoard, black_parts, check_board, load_board, opencv_board
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.scenes.picture_codec import encode_png
from rhizotwin.scenes.transfer import LINEAR, SRGB, Curve
from rhizotwin.sim.board import board_picture, draw_pose, project, simulate_board

Array = NDArray[np.float64]
BOARD = CharucoBoard()
BENCH = (-0.05, 0.02, 0.0003, -0.0002, 0.0)
SMALL = Scene(camera=Camera().resized((400, 300)))


@pytest.mark.parametrize(("squares_xy", "legacy"), [((6, 8), False), ((6, 8), True), ((7, 5), True)])
def test_the_board_is_opencv_s_pattern(squares_xy: tuple[int, int], legacy: bool) -> None:
    board = CharucoBoard(squares_xy=squares_xy, square_mm=24.0, marker_mm=18.0, dictionary="4X4_50", legacy_pattern=legacy)
    theirs = opencv_board(board)
    np.testing.assert_allclose(theirs.getChessboardCorners(), board.corners_mm)
    wide, high = (round(side) for side in board.size_mm)
    mine = np.full((high, wide), 255, np.uint8)
    for left, top, right, bottom in np.rint(black_parts(board)).astype(int):
        mine[top:bottom, left:right] = 0
    np.testing.assert_array_equal(mine, theirs.generateImage((wide, high)))


def test_mistakes_of_a_board_file_are_named(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("[board]\nsquare_mm = 20.0\nmarker_mm = 19.5\n", encoding="utf-8")
    with pytest.raises(UserError, match=r"line 3: \[board\] marker_mm = 19.5: must be at most 18"):
        load_board(tmp_path / "bad.toml")
    with pytest.raises(UserError, match="requires 60 markers, but 4X4_50 has only 50"):
        check_board(CharucoBoard(squares_xy=(12, 10), dictionary="4X4_50"))


def flat_picture(board: CharucoBoard = BOARD, *, px_per_mm: float = 3.0) -> NDArray[np.uint8]:
    """Return the board straight on, with its white border."""
    paper = board_picture(board)
    scale = px_per_mm / 12.0
    return np.asarray(255.0 * cv2.resize(paper, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def test_corners_of_a_board_straight_on_even_large_and_dark() -> None:
    large = cv2.resize(flat_picture(), None, fx=4.0, fy=4.0, interpolation=cv2.INTER_CUBIC).astype(np.uint16) * 8
    assert max(large.shape) > 2100
    for picture, px_per_mm, atol in ((flat_picture(), 3.0, 0.02), (large, 12.0, 0.1)):
        found = find_board(picture, BOARD)
        assert isinstance(found, BoardView)
        np.testing.assert_array_equal(found.ids, np.arange(24))
        np.testing.assert_allclose(found.corners_px, (BOARD.corners_mm[:, :2] + 12.0) * px_per_mm - 0.5, atol=atol)


USELESS = {
    "mirrored": (np.ascontiguousarray(flat_picture()[:, ::-1]), "mirrored"),
    "other dictionary": (flat_picture(CharucoBoard(dictionary="APRILTAG_36h11")), "markers of APRILTAG_36h11"),
    "other board": (flat_picture(CharucoBoard(squares_xy=(5, 7))), "not in the arrangement of a board of 7x5 squares; the board has 5x7"),
    "larger board": (flat_picture(CharucoBoard(squares_xy=(8, 6))), "0 to 16, but the picture shows marker 23"),
    "few corners": (flat_picture()[:160, :260], "8 are needed"),
}


@pytest.mark.parametrize(("picture", "reason"), USELESS.values(), ids=USELESS)
def test_a_useless_picture_is_refused_with_its_reason(picture: NDArray[np.uint8], reason: str) -> None:
    found = find_board(picture, BOARD)
    assert isinstance(found, NoBoard)
    assert reason in found.reason


def test_the_pattern_of_the_pictures_is_used(tmp_path: Path) -> None:
    """A board with an even number of rows in the pattern of OpenCV before 4.6, which the board file does not state."""
    board = CharucoBoard(squares_xy=(6, 4), square_mm=30.0, legacy_pattern=True)
    flat, (width, height) = flat_picture(board), board.size_mm
    ends_mm = np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    for k in range(4):
        seen_px = project(SMALL.camera, draw_pose(SMALL, board, seed=0, index=k), ends_mm)
        warp = cv2.getPerspectiveTransform(((ends_mm[:, :2] + 12.0) * 3.0 - 0.5).astype(np.float32), seen_px.astype(np.float32))
        write_image(tmp_path / f"{k}.png", cv2.warpPerspective(flat, warp, (400, 300), flags=cv2.INTER_AREA, borderValue=255))
    made = calibrate(sorted(tmp_path.iterdir()), replace(board, legacy_pattern=False))
    assert made.board == board
    np.testing.assert_allclose(made.camera.focal_px, SMALL.camera.focal_px, rtol=0.01)


def seen_views(
    camera: Camera, *, pictures: int = 20, noise_px: float = 0.03, seed: int = 0, poses: list[Array] | None = None
) -> dict[str, BoardView]:
    """Return corners of the board in pictures of a known camera, with noise."""
    rng = np.random.default_rng(seed)
    scene = Scene(camera=camera)
    views = {}
    for k, pose in enumerate(poses or [draw_pose(scene, BOARD, seed=seed, index=k) for k in range(pictures)]):
        corners = project(camera, pose, BOARD.corners_mm)
        inside = np.all((corners > 5.0) & (corners < np.array(camera.image_wh) - 6.0), axis=1)
        noisy = corners[inside] + rng.normal(0.0, noise_px, (np.count_nonzero(inside), 2))
        views[f"{k:02d}.png"] = BoardView(ids=np.flatnonzero(inside), corners_px=noisy, sigma_px=noise_px, blur_px=0.4)
    return views


CURVED = replace(Camera(), distortion=BENCH, principal_px=(410.0, 290.0))
LENSES = {
    "straight": (Camera(), {"fx / fy", "k3", "p1, p2", "k2", "k1"}),
    "bench": (CURVED, {"fx / fy", "k3"}),
    "everything": (Camera(focal_px=(900.0, 905.0), distortion=(-0.25, 0.1, 0.001, -0.001, -0.3)), set()),
}


@pytest.mark.parametrize(("true", "left_out"), LENSES.values(), ids=LENSES)
def test_the_lens_is_found_with_no_more_terms_than_it_has(true: Camera, left_out: set[str]) -> None:
    fit = fit_lens(seen_views(true), BOARD, true.image_wh)
    assert set(fit.left_out) == left_out
    assert fit.rms_px == pytest.approx(0.03 * np.sqrt(2.0), rel=0.15)
    np.testing.assert_allclose(fit.focal_px, true.focal_px, rtol=1e-3)
    found = np.array([*fit.focal_px, *fit.principal_px, *fit.distortion])
    std = np.array([*fit.focal_std_px, *fit.principal_std_px, *fit.distortion_std])
    wrong = np.abs(found - np.array([*true.focal_px, *true.principal_px, *true.distortion]))
    assert np.all(wrong <= 4.0 * std + 1e-9), f"{wrong} for {std}"


def test_standard_deviations_are_honest() -> None:
    off, poses = [], [draw_pose(Scene(camera=CURVED), BOARD, seed=0, index=k) for k in range(12)]
    for seed in range(6):
        fit = fit_lens(seen_views(CURVED, seed=seed, poses=poses), BOARD, CURVED.image_wh)
        off.append([(fit.focal_px[1] - 1300.0) / fit.focal_std_px[1], (fit.principal_px[0] - 410.0) / fit.principal_std_px[0]])
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.7


def test_a_bent_picture_and_a_wrong_corner_are_left_out() -> None:
    views = seen_views(CURVED, pictures=12)
    bent = views["07.png"]
    views["07.png"] = replace(bent, corners_px=bent.corners_px + 3.0 * np.sin(bent.corners_px / 40.0))
    views["03.png"].corners_px[5] += 1.5
    fit = fit_lens(views, BOARD, CURVED.image_wh)
    assert list(fit.rejected) == ["07.png"]
    assert "px rms" in fit.rejected["07.png"]
    assert fit.dropped_corners == 1
    assert len(fit.views["03.png"].ids) == len(views["03.png"].ids) - 1
    np.testing.assert_allclose(fit.focal_px, CURVED.focal_px, rtol=1e-3)


def held(tilts_deg: list[float], directions_deg: list[float], *, aside_mm: float = 0.0) -> list[Array]:
    """Return poses of the board before the camera, tilted towards directions."""
    poses = []
    for k, (tilt, direction) in enumerate(zip(tilts_deg, directions_deg, strict=True)):
        axis = np.deg2rad(tilt) * np.array([np.cos(np.deg2rad(direction)), np.sin(np.deg2rad(direction)), 0.0])
        turn = Rotation.from_rotvec(axis)
        middle = np.array([aside_mm * np.cos(k), aside_mm * np.sin(k), 400.0 + 5.0 * k])
        poses.append(frames.from_rotation_translation(turn.as_matrix(), middle - turn.apply([*np.array(BOARD.size_mm) / 2.0, 0.0])))
    return poses


FLAT = held([1.0, 2.0, 3.0, 2.0, 1.0, 3.0], [0.0, 60.0, 120.0, 180.0, 240.0, 300.0], aside_mm=10.0)
UNDETERMINED = {
    "flat": (FLAT, r"tilted by at most|not consistent with any focal length"),
    "alike": (held([30.0], [20.0]) * 6, "only 1 different orientations"),
}


@pytest.mark.parametrize(("poses", "says"), UNDETERMINED.values(), ids=UNDETERMINED)
def test_poses_that_determine_no_lens_are_refused(poses: list[Array], says: str) -> None:
    with pytest.raises(RigError, match=says):
        calibrate_views(seen_views(Camera(), poses=poses), BOARD, (800, 600))


def test_too_few_pictures_are_refused_few_are_warned_of() -> None:
    views = seen_views(Camera(), pictures=6)
    with pytest.raises(RigError, match="2 pictures of the board can be used"):
        calibrate_views(dict(list(views.items())[:2]), BOARD, (800, 600))
    assert "only 6 pictures" in " ".join(calibrate_views(views, BOARD, (800, 600)).warnings)
    one_axis = held([-40.0, -30.0, -20.0, 0.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0], [90.0] * 10, aside_mm=30.0)
    assert "about one axis" in " ".join(calibrate_views(seen_views(Camera(), poses=one_axis), BOARD, (800, 600)).warnings)
    assert not calibrate_views(seen_views(Camera(), pictures=12), BOARD, (800, 600)).warnings


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("twin") / "pictures"
    simulate_board(replace(SMALL, disturbances=load_profile("bench")), BOARD, folder, pictures=10, seed=1)
    return folder


def true_lens(folder: Path) -> tuple[Camera, dict[str, Array]]:
    truth = json.loads((folder / "truth" / "camera.json").read_text(encoding="utf-8"))
    lens = {key: tuple(value) if isinstance(value, list) else value for key, value in truth["camera"].items()}
    return Camera(**lens), {name: np.array(pose) for name, pose in truth["cam_from_board"].items()}


def test_corners_of_the_twin_are_where_they_are_projected(twin: Path) -> None:
    camera, poses = true_lens(twin)
    assert camera.distortion == BENCH
    found = {name: find_board(cv2.imread(str(twin / name), cv2.IMREAD_UNCHANGED), BOARD) for name in poses}
    wrong = np.concatenate([one.corners_px - project(camera, poses[name], BOARD.corners_mm)[one.ids] for name, one in found.items()])
    assert len(wrong) > 100
    assert np.abs(wrong.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(wrong**2)) < 0.04
    assert 0.5 < np.sqrt(np.mean(wrong**2)) / np.mean([one.sigma_px for one in found.values()]) < 2.0


def test_a_board_that_does_not_suit_the_camera_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="too large for the camera at 400 mm"):
        simulate_board(SMALL, CharucoBoard(square_mm=200.0, marker_mm=140.0), tmp_path / "large")


def test_the_lens_of_the_twin_and_its_bad_pictures(twin: Path, tmp_path: Path) -> None:
    paths = sorted(twin.glob("*.png"))
    bad = [tmp_path / name for name in ("cut.png", "dark.png", "large.png", "turned.png")]
    bad[0].write_bytes(paths[0].read_bytes()[:5000])
    write_image(bad[1], np.full((300, 400), 100, np.uint16))
    write_image(bad[2], flat_picture())
    said = Image.Exif()
    said[274] = 3  # the camera upside down, which moves the principal point
    Image.open(paths[0]).save(bad[3], exif=said)
    made = calibrate(paths + bad, BOARD)
    true, _ = true_lens(twin)
    assert set(made.rejected) == {path.name for path in bad}
    for path, reason in zip(bad, ("truncated", "no board", "most others 400x300", "tag 3, but most others"), strict=True):
        assert reason in made.rejected[path.name]
    np.testing.assert_allclose(made.camera.focal_px, true.focal_px, rtol=1e-3)
    np.testing.assert_allclose(made.camera.principal_px, true.principal_px, atol=1.0)


def test_names_of_pictures_are_no_formulas_in_the_report(tmp_path: Path) -> None:
    views = {f"a$_^$ <{name}>": view for name, view in seen_views(SMALL.camera, pictures=6).items()}
    path = write_report(calibrate_views(views, BOARD, SMALL.camera.image_wh), tmp_path)
    assert "a$_^$ &lt;" in path.read_text(encoding="utf-8")


def test_no_usable_picture_at_all_is_one_sentence(tmp_path: Path) -> None:
    for k in range(3):
        write_image(tmp_path / f"{k}.png", np.full((300, 400), 100, np.uint8))
    with pytest.raises(RigError, match=r"none of the 3 pictures can be used; 0.png: no board was found.*2 other pictures"):
        calibrate(sorted(tmp_path.iterdir()), BOARD)


TIMES = (0.002, 0.004, 0.008, 0.016, 0.032)
SHOULDER = Curve("film", tuple((np.linspace(0.0, 1.0, 513) ** 1.6 * (0.7 + 0.3 * np.linspace(0.0, 1.0, 513) ** 3)).tolist()))


def pictures(curve: Curve, times: tuple[float, ...] = TIMES) -> list[np.ndarray]:
    """Expose a ramp from dark to bright: the middle time reaches 0.8 of full scale."""
    rng = np.random.default_rng(0)
    scene = np.geomspace(0.004, 0.8, 120)[None, :] * np.ones((90, 1))
    lights = (np.clip(rng.poisson(8000.0 * scene * t / 0.008) / 8000.0, 0.0, 1.0) for t in times)
    return [np.rint(255.0 * curve.number(light)).astype(np.uint8) for light in lights]


@pytest.mark.parametrize("curve", [LINEAR, SRGB, SHOULDER], ids=lambda one: one.name)
def test_a_curve_comes_back(curve: Curve) -> None:
    found = fit_transfer(pictures(curve), TIMES)
    share = np.linspace(0.1, 0.95, 30)
    factor = found.curve.of(np.array(0.6)) / curve.of(np.array(0.6))  # exposures tell no common factor
    assert factor == pytest.approx(1.0, abs=0.04)
    np.testing.assert_allclose(found.curve.of(share), factor * curve.of(share), atol=0.015)
    assert found.residual < 0.005
    assert (found.curve in (LINEAR, SRGB)) == (curve in (LINEAR, SRGB))


def test_rounded_times_are_corrected_adaptive_curves_refused() -> None:
    stated, true = (1 / 125, 1 / 60, 1 / 30, 1 / 15, 1 / 8), (1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 8)
    exposed = pictures(LINEAR, tuple(time / 4 for time in true))
    found = fit_transfer(exposed, stated)
    assert (found.curve, found.rounded) == (LINEAR, True)
    assert found.residual < 0.005
    adapted = [np.rint(255.0 * (image / 255.0) ** (1.0 - 0.1 * (k % 2))).astype(np.uint8) for k, image in enumerate(exposed)]
    with pytest.raises(RigError, match=r"no function of the light: the residual is .* use raw files"):
        fit_transfer(adapted, stated)


def test_an_exposure_series_of_raw_files(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.dng" for k in range(3)]
    light = np.tile(np.linspace(0.1, 0.9, 16), (16, 1))
    for k, path in enumerate(paths):
        path.write_bytes(encode_dng(light / 2**k, exposure_s=0.016 / 2**k))
    images, times = read_series(paths, None)
    assert times == pytest.approx([0.016, 0.008, 0.004])
    assert images[2] / 65535.0 == pytest.approx(light / 4.0, abs=2e-4)


@pytest.mark.parametrize("exposures", ["0.002,nan,0.008", "0.002,0,0.008", "0.002,0.008"])
def test_impossible_exposure_times_are_refused(exposures: str, tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.png" for k in range(3)]
    for path in paths:
        path.write_bytes(encode_png(np.zeros((16, 16), np.uint8)))
    with pytest.raises(UserError, match="specify a positive exposure time for each picture"):
        read_series(paths, exposures)


def test_exposures_that_are_too_alike_are_refused() -> None:
    times = (0.008, 0.009, 0.010)
    with pytest.raises(RigError, match=r"0\.008 to 0\.01 s"):
        fit_transfer(pictures(SRGB, times), times)


def test_pictures_all_clipped_are_refused() -> None:
    with pytest.raises(RigError, match="too few pixels"):
        fit_transfer([np.full((90, 120), 255, np.uint8)] * 5, TIMES)
