"""One-page report of a calibration: results, residuals over the picture, coverage, and a list of the pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from rhizotwin.rig.lens.calibration import CELLS_WH, Calibration, covered_cells, model_text
from rhizotwin.rig.lens.lens_fit import TERMS, residual_rms
from rhizotwin.scenes import html_page
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.html_page import table
from rhizotwin.scenes.schema import to_plain

if TYPE_CHECKING:  # importing matplotlib takes long, and is not needed for calibrating on a Raspberry Pi
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI: Final = 120
ARROW_SHARE: Final = 0.06
"""Length of the arrow that represents a large residual, as a fraction of the picture's width. A large residual is the
95th percentile of all residuals."""


def write_report(made: Calibration, folder: Path) -> Path:
    """Write a self-contained ``report.html`` into a folder, and return its path."""
    path = folder / "report.html"
    write_text(path, _page(made))
    return path


def draw(made: Calibration) -> "Figure":
    """Draw the residuals over the picture, the coverage, the distortion, and the residual of each picture."""
    bars = len(made.fit.views)
    drawn = figure(11.0, 8.6 + 0.14 * bars)
    grid = drawn.add_gridspec(3, 2, height_ratios=(4.2, 4.2, 1.0 + 0.16 * bars))
    _residuals(drawn.add_subplot(grid[0, 0]), made)
    _coverage(drawn.add_subplot(grid[0, 1]), made)
    _distortion(drawn.add_subplot(grid[1, 0]), made)
    _scatter(drawn.add_subplot(grid[1, 1]), made)
    _pictures(drawn.add_subplot(grid[2, :]), made)
    return drawn


def _field(axes: "Axes", made: Calibration, title: str) -> None:
    width, height = made.camera.image_wh
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="x, px", ylabel="y, px")
    axes.set_title(title, fontsize=10)


def _residuals(axes: "Axes", made: Calibration) -> None:
    """Draw the residual of each corner as an enlarged arrow."""
    corners = np.concatenate([view.corners_px for view in made.fit.views.values()])
    residuals = np.concatenate(list(made.fit.residuals_px.values()))
    large_px = max(float(np.percentile(np.linalg.norm(residuals, axis=1), 95.0)), 1e-9)
    times = ARROW_SHARE * made.camera.image_wh[0] / large_px
    arrows = residuals * times
    lines: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.002, "color": "#a03020"}
    axes.quiver(corners[:, 0], corners[:, 1], arrows[:, 0], arrows[:, 1], **lines)
    _field(axes, made, f"residuals, enlarged {times:.0f} times; {made.fit.rms_px:.3f} px rms")


def _coverage(axes: "Axes", made: Calibration) -> None:
    """Draw the corner positions over the covered cells of the picture."""
    width, height = made.camera.image_wh
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(covered_cells(made.fit, made.camera.image_wh), extent=extent, cmap="Greens", vmin=0.0, vmax=2.5, aspect="equal")
    for view in made.fit.views.values():
        axes.plot(view.corners_px[:, 0], view.corners_px[:, 1], ".", markersize=3)
    _field(axes, made, f"corners by picture; they cover {made.coverage:.0%} of the picture ({CELLS_WH[0]} x {CELLS_WH[1]} cells)")


def _distortion(axes: "Axes", made: Calibration) -> None:
    """Draw the displacement of pixels by the lens distortion."""
    width, height = made.camera.image_wh
    x, y = np.meshgrid(np.linspace(0.0, width - 1.0, 60), np.linspace(0.0, height - 1.0, 45))
    (fx, fy), (cx, cy) = made.fit.focal_px, made.fit.principal_px
    rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=-1).reshape(-1, 3)
    matrix, still = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.zeros(3)
    px, _ = cv2.projectPoints(rays, still, still, matrix, np.array(made.fit.distortion))
    moved_px = np.linalg.norm(px.reshape(*x.shape, 2) - np.stack([x, y], axis=-1), axis=-1)
    if float(moved_px.max()) > 1e-6:
        axes.clabel(axes.contour(x, y, moved_px, levels=8, cmap="viridis"), fontsize=7)
    axes.plot(*made.fit.principal_px, "k+")
    _field(axes, made, "displacement by distortion, px; + is the principal point")


def _scatter(axes: "Axes", made: Calibration) -> None:
    for residuals in made.fit.residuals_px.values():
        axes.plot(residuals[:, 0], residuals[:, 1], ".", markersize=3)
    reach_px = 1.1 * max(float(np.abs(residuals).max()) for residuals in made.fit.residuals_px.values())
    axes.set(xlim=(-reach_px, reach_px), ylim=(reach_px, -reach_px), aspect="equal", xlabel="x, px", ylabel="y, px")
    axes.axhline(0.0, color="#bbb", linewidth=0.7)
    axes.axvline(0.0, color="#bbb", linewidth=0.7)
    axes.set_title("residuals by picture; pure noise would appear as a round cloud", fontsize=10)


def _pictures(axes: "Axes", made: Calibration) -> None:
    names = list(made.fit.views)
    rms = [residual_rms(made.fit.residuals_px[name]) for name in names]
    axes.barh(range(len(names)), rms, color="#6080a0")
    axes.axvline(made.fit.rms_px, color="#a03020", linewidth=1.0)
    axes.set_yticks(range(len(names)), [name[-40:] for name in names], fontsize=7, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlabel("residual of each picture, px rms; the line marks the residual of all pictures", fontsize=9)


def _page(made: Calibration) -> str:
    """Return the report as self-contained HTML."""
    fit, rejected = made.fit, list(made.rejected.items())
    used = []
    for name, view in fit.views.items():
        rms_px = residual_rms(fit.residuals_px[name])
        used.append([name, str(len(view.ids)), f"{made.tilts_deg[name]:.0f}", f"{rms_px:.3f}", f"{view.blur_px:.2f}"])
    picture = html_page.image("png", png(draw(made), dpi=DPI), "residuals, coverage, distortion")
    head = ("picture", "corners", "tilt, degrees", "residual, px", "blur, px")
    board = [(key, str(value)) for key, value in to_plain(made.board).items()]
    return html_page.document(
        "Camera calibration",
        f"<h1>Camera calibration</h1><div class=out>{html_page.items(made.warnings)}</div><h2>The lens</h2>",
        table(_lens(made), head=("", "value", "standard deviation"), numbers=(1,)),
        f"<p>Fitted: {html_page.escape(model_text(fit))}.</p><h2>Residuals</h2><figure>{picture}</figure><h2>Pictures used</h2>",
        table(used, head=head, numbers=(1, 2, 3, 4)),
        f"<h2>Excluded pictures</h2>{table(rejected, head=('picture', 'reason'))}" if rejected else "",
        f"<h2>Board</h2>{table(board, head=('key', 'value'))}",
    )


def _lens(made: Calibration) -> list[list[str]]:
    fit = made.fit
    rows: list[tuple[str, float, float]] = [
        ("fx, px", fit.focal_px[0], fit.focal_std_px[0]),
        ("fy, px", fit.focal_px[1], fit.focal_std_px[1]),
        ("cx, px", fit.principal_px[0], fit.principal_std_px[0]),
        ("cy, px", fit.principal_px[1], fit.principal_std_px[1]),
        *zip(TERMS, fit.distortion, fit.distortion_std, strict=True),
    ]
    shown = [[name, f"{value:.6g}", f"{std:.2g}" if std > 0.0 else "not fitted"] for name, value, std in rows]
    return [
        *shown,
        ["picture, px", f"{made.camera.image_wh[0]} x {made.camera.image_wh[1]}", ""],
        [
            "residual, px rms",
            f"{fit.rms_px:.3f}",
            f"{fit.corners} corners in {len(fit.views)} pictures; {fit.dropped_corners} corners excluded",
        ],
    ]
