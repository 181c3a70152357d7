"""Fit of a lens model to the corners of a flat board in several pictures.

Terms of the model that the pictures do not support are omitted.
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.lens.board_corners import BoardView
from rhizotwin.scenes import frames
from rhizotwin.scenes.board import CharucoBoard
from rhizotwin.scenes.frames import Array

LEAST_PICTURES: Final = 3
MOST_RMS_TIMES: Final = 3.0
"""Threshold for excluding a picture as an outlier: ratio of its root mean square residual to the median of all
pictures. A picture is excluded only if its residual also exceeds `MOST_RMS_PX`."""
MOST_RMS_PX: Final = 0.5
FAR_SIGMAS: Final = 5.0
"""Threshold for excluding a corner as an outlier: ratio of its residual to the robust standard deviation of all
residuals. A corner is excluded only if its residual also exceeds `FAR_PX`."""
FAR_PX: Final = 0.25
LEAST_LEFT: Final = 6
"""Minimum number of corners that must remain in a picture when outliers are excluded."""
TERMS: Final = ("k1", "k2", "p1", "p2", "k3")
DROPPED: Final = {
    "k3": cv2.CALIB_FIX_K3,
    "p1, p2": cv2.CALIB_ZERO_TANGENT_DIST,
    "k2": cv2.CALIB_FIX_K2,
    "k1": cv2.CALIB_FIX_K1,
    "fx / fy": cv2.CALIB_FIX_ASPECT_RATIO,
}
"""Optional terms of the lens model, with the OpenCV flags that omit them."""
BEFORE: Final = {"k2": "k3", "k1": "k2"}
"""Order in which distortion terms are omitted. A key can be omitted only if its value, which is the next higher term,
was already omitted."""


@dataclass(frozen=True, kw_only=True)
class LensFit:
    """Fitted lens model, with standard deviations and residuals."""

    focal_px: tuple[float, float]
    focal_std_px: tuple[float, float]
    """Standard deviations of the focal lengths, estimated from the residuals, px."""
    principal_px: tuple[float, float]
    principal_std_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    """Coefficients k1, k2, p1, p2, k3 of the OpenCV model. They are 0 for terms that were not fitted."""
    distortion_std: tuple[float, float, float, float, float]
    """Standard deviations of the coefficients. They are 0 for terms that were not fitted."""
    left_out: tuple[str, ...]
    """Terms of the model that the pictures do not support: k3, "p1, p2", k2, k1, or fx / fy. If fx / fy is omitted, a
    common focal length is fitted."""
    full: dict[str, tuple[float, float]]
    """Value and standard deviation of every distortion coefficient, from the fit with all terms."""
    rms_px: float
    """Root mean square distance between measured and reprojected corners, px."""
    cam_from_board: dict[str, Array]
    """Pose of the board in the camera's frame (4x4) for each picture. The keys are file names."""
    residuals_px: dict[str, Array]
    """Differences between the measured and the reprojected corners (N, 2) of each picture, px. The keys are file
    names."""
    views: dict[str, BoardView]
    """Corners used in the fit. The keys are file names."""
    dropped_corners: int
    """Number of corners that were excluded as outliers."""
    rejected: dict[str, str]
    """Reason why a picture was excluded as inconsistent with the other pictures. The keys are file names."""

    @property
    def corners(self) -> int:
        """Number of corners used in the fit."""
        return sum(len(view.ids) for view in self.views.values())


@dataclass(frozen=True)
class _Solution:
    """Result of the OpenCV fit for one set of terms."""

    matrix: Array
    distortion: Array
    std: Array
    rvecs: list[Array]
    tvecs: list[Array]
    residuals: list[Array]

    @property
    def squares(self) -> float:
        return float(sum(np.sum(r * r) for r in self.residuals))

    @property
    def rms_px(self) -> float:
        return float(np.sqrt(self.squares / sum(len(r) for r in self.residuals)))


def fit_lens(views: dict[str, BoardView], board: CharucoBoard, image_wh: tuple[int, int]) -> LensFit:
    """Fit focal lengths, principal point and distortion to the corners of all pictures.

    Pictures and corners that are inconsistent with all others are excluded. Then terms of the model are omitted as long
    as this decreases the Bayesian information criterion N ln(residual sum of squares) + p ln N (Schwarz 1978).

    Parameters
    ----------
    views : dict of BoardView
        Corners by file name.
    board, image_wh : CharucoBoard, tuple of int
        Dimensions of the printed board, and width and height of the pictures, px.

    Raises
    ------
    RigError
        If fewer than `LEAST_PICTURES` pictures are usable, or no lens model fits the pictures.
    """
    rejected: dict[str, str] = {}
    first = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    start: _Solution | None = None
    while True:
        _check_enough(views, rejected)
        start = _solve(views, board, image_wh, flags=first)
        worst = _worst_picture(views, start)
        if worst is None:
            break
        name, rms_px = worst
        others = float(np.median([residual_rms(r) for r in start.residuals]))
        rejected[name] = (
            f"the corners deviate from the lens model of the other pictures by {rms_px:.2f} px rms (typically {others:.2f} px); "
            "check that the board is flat and was not moving"
        )
        views = {key: view for key, view in views.items() if key != name}
    full = _solve(views, board, image_wh, flags=0, start=start)
    kept, dropped = views, 0
    while (fewer := _without_worst(kept, full)) is not None:
        kept, dropped = fewer, dropped + 1
        full = _solve(kept, board, image_wh, flags=0, start=full)
    chosen, left_out = _fewest_terms(kept, board, image_wh, full)
    poses = [frames.from_rotvec(rvec.ravel(), tvec.ravel()) for rvec, tvec in zip(chosen.rvecs, chosen.tvecs, strict=True)]
    std = [float(value) for value in chosen.std]
    fx, fy = float(chosen.matrix[0, 0]), float(chosen.matrix[1, 1])
    k = [float(value) for value in chosen.distortion]
    return LensFit(
        focal_px=(fx, fy),
        focal_std_px=(std[1] * fx / fy, std[1]) if "fx / fy" in left_out else (std[0], std[1]),
        principal_px=(float(chosen.matrix[0, 2]), float(chosen.matrix[1, 2])),
        principal_std_px=(std[2], std[3]),
        distortion=(k[0], k[1], k[2], k[3], k[4]),
        distortion_std=(std[4], std[5], std[6], std[7], std[8]),
        left_out=left_out,
        full={term: (float(full.distortion[i]), float(full.std[4 + i])) for i, term in enumerate(TERMS)},
        rms_px=chosen.rms_px,
        cam_from_board=dict(zip(kept, poses, strict=True)),
        residuals_px=dict(zip(kept, chosen.residuals, strict=True)),
        views=kept,
        dropped_corners=dropped,
        rejected=rejected,
    )


def _check_enough(views: dict[str, BoardView], rejected: dict[str, str]) -> None:
    if len(views) < LEAST_PICTURES:
        why = f", after the exclusion of {len(rejected)} pictures that are inconsistent with the others" if rejected else ""
        raise RigError(
            f"the lens cannot be fitted: only {len(views)} pictures of the board can be used{why}, but at least {LEAST_PICTURES} are "
            "needed; take about 20 pictures"
        )


def _solve(
    views: dict[str, BoardView], board: CharucoBoard, image_wh: tuple[int, int], *, flags: int, start: _Solution | None = None
) -> _Solution:
    """Run the OpenCV calibration with a set of flags, and check its result."""
    corners_mm = board.corners_mm.astype(np.float32)
    at_mm = [corners_mm[view.ids] for view in views.values()]
    at_px = [view.corners_px.astype(np.float32) for view in views.values()]
    matrix, distortion = np.eye(3), np.zeros(5)
    if start is None:
        # The matrix is the identity. OpenCV's initial estimate is more stable with one focal length
        flags |= cv2.CALIB_FIX_ASPECT_RATIO
    else:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        matrix = start.matrix.copy()
        if flags & cv2.CALIB_FIX_ASPECT_RATIO:
            matrix[0, 0] = matrix[1, 1]
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    try:
        _, matrix, distortion, rvecs, tvecs, std, _, _ = cv2.calibrateCameraExtended(
            at_mm, at_px, image_wh, matrix, distortion, flags=flags, criteria=criteria
        )
    except cv2.error as error:
        raise RigError(
            f"the lens cannot be fitted: OpenCV failed with {' '.join(str(error).split())[:150]}; "
            "take pictures with the board tilted in all directions"
        ) from error
    distortion = np.ravel(distortion)[:5]
    residuals = []
    for q, p, rvec, tvec in zip(at_mm, views.values(), rvecs, tvecs, strict=True):
        reprojected, _ = cv2.projectPoints(q.astype(np.float64), rvec, tvec, matrix, distortion)
        residuals.append(p.corners_px - np.reshape(reprojected, (-1, 2)))
    found = _Solution(np.asarray(matrix), distortion, np.ravel(std)[:9], list(rvecs), list(tvecs), residuals)
    sound = np.isfinite(found.squares) and min(matrix[0, 0], matrix[1, 1]) > 0.0
    if not sound:
        raise RigError(
            "the lens cannot be fitted: the pictures are not consistent with any focal length; "
            "take pictures with the board tilted in all directions"
        )
    return found


def residual_rms(residuals: Array) -> float:
    """Return the root mean square length of the residuals (N, 2) of a picture, in their unit."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def _worst_picture(views: dict[str, BoardView], found: _Solution) -> tuple[str, float] | None:
    """Return the name and the residual (px) of the picture with the largest residual.

    The result is None if this picture is consistent with the others.
    """
    rms = np.array([residual_rms(r) for r in found.residuals])
    k = int(np.argmax(rms))
    return (list(views)[k], float(rms[k])) if rms[k] > max(MOST_RMS_PX, MOST_RMS_TIMES * float(np.median(rms))) else None


def _without_worst(views: dict[str, BoardView], found: _Solution) -> dict[str, BoardView] | None:
    """Return the views without the corner that has the largest residual.

    The result is None if no corner is an outlier, or if too few corners would remain in the picture. Corners are
    removed one at a time, because a wrong corner also displaces the reprojections of its neighbours.
    """
    lengths = [np.linalg.norm(r, axis=1) for r in found.residuals]
    # from the median of a Rayleigh distribution
    sigma = float(np.median(np.concatenate(lengths))) / np.sqrt(2.0 * np.log(2.0))
    k = int(np.argmax([float(far.max()) for far in lengths]))
    name, far = list(views)[k], lengths[k]
    if far.max() <= max(FAR_PX, FAR_SIGMAS * sigma) or len(far) <= LEAST_LEFT:
        return None
    others = np.arange(len(far)) != int(np.argmax(far))
    view = views[name]
    return views | {name: replace(view, ids=view.ids[others], corners_px=view.corners_px[others])}


def _fewest_terms(
    views: dict[str, BoardView], board: CharucoBoard, image_wh: tuple[int, int], full: _Solution
) -> tuple[_Solution, tuple[str, ...]]:
    """Omit terms of the lens model one by one, as long as the Bayesian information criterion decreases.

    Return the last fit and the omitted terms. All fits use the same corners.
    """
    count = 2 * sum(len(view.ids) for view in views.values())

    def criterion(found: _Solution, left_out: tuple[str, ...]) -> float:
        terms = 9 - sum(2 if term == "p1, p2" else 1 for term in left_out)
        return count * float(np.log(max(found.squares, 1e-12) / count)) + terms * float(np.log(count))

    best = full
    left_out: tuple[str, ...] = ()
    while True:
        trials = []
        for term in DROPPED:
            if term in left_out or BEFORE.get(term, term) not in (*left_out, term):
                continue
            fewer = (*left_out, term)
            flags = 0
            for name in fewer:
                flags |= DROPPED[name]
            trials.append((fewer, _solve(views, board, image_wh, flags=flags, start=best)))
        scored = [(criterion(found, fewer), fewer, found) for fewer, found in trials]
        lowest = min(scored, key=lambda row: row[0], default=None)
        if lowest is None or lowest[0] >= criterion(best, left_out):
            return best, left_out
        _, left_out, best = lowest
