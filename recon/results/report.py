"""Write the pictures of a result and one page with its numbers, for people."""

import base64
import html
import io
from pathlib import Path

from matplotlib.figure import Figure

from rhizotwin.recon.results import pictures, report_roots, report_tables, result_files, result_traits
from rhizotwin.recon.results.result_files import Json
from rhizotwin.scenes import atomic, rsml
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.traits import Traits

DPI = 130
"""Letters of 9 pt are 16 px high."""

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; } td, th { padding: 2px 14px 2px 0; text-align: left; vertical-align: top; }
th { font-weight: 600; border-bottom: 1px solid #ccc; } td.number { text-align: right; font-variant-numeric: tabular-nums; }
.warning { background: #fff4e0; border-left: 4px solid #e0a030; padding: 4px 10px; margin: 6px 0; }
.volume { font-size: 1.6em; margin: 0.4em 0; }
.out td { color: #b03020; } img { max-width: 100%; } figcaption { color: #555; } figure { margin: 1em 0; }
"""

ROOT_PICTURES = ("roots.png", "lengths.png")

CAPTIONS = {
    "inputs.png": "Pictures above their silhouettes; what a picture says nothing about is tinted red.",
    "cameras.png": "Where the cameras stood, in the canister's frame; crosses are views that were left out.",
    "roots.png": "The found centre lines, as thick as they are, beside the pictures taken nearest to the same sides: water magnifies.",
    "lengths.png": "Where the length of the roots is.",
    "shape.png": "The reconstructed shape from two sides.",
    "shape_and_truth.png": "The reconstructed shape, the true one, and the distance between them, from two sides.",
}


def write_pictures(result_folder: Path, dataset: Path | Dataset, *, truth_mesh: Path | None = None) -> list[Path]:
    """Write ``pictures/*.png`` and ``report.html`` into a result folder.

    A picture of the dataset that cannot be read any more is left out: the result is made already, and must not be lost with it.

    Parameters
    ----------
    dataset
        That the result was made from: its folder, or as it was loaded then.
    truth_mesh
        File of the true solid; where given, the shape is drawn beside it (``shape_and_truth.png``). Simulated data only.

    Returns
    -------
    list of Path
        What was written, the page last.

    Raises
    ------
    UserError
        If the result or the dataset lacks a file, or does not fit the other.
    """
    result_folder = Path(result_folder)
    summary = result_files.read_summary(result_folder)
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    result_files.check_same_scan(summary["dataset_sha256"], summary["scene"], result_folder, dataset)
    shape = result_files.read_mesh(result_folder / "shape.ply")

    written: list[Path] = []
    inputs = pictures.inputs_and_silhouettes(summary, result_folder, dataset)
    if inputs is not None:
        written.append(_save(inputs, result_folder, "inputs.png"))
    written.append(_save(pictures.camera_ring(summary, dataset), result_folder, "cameras.png"))
    title = f"{summary['scene']}: {summary['volume_mm3']:.1f} mm3, voxels of {summary['voxel_mm']:g} mm"
    written.append(_save(pictures.shape_in_canister(shape, dataset.scene, title=title), result_folder, "shape.png"))
    if truth_mesh is not None:
        written.append(write_shape_and_truth(result_folder, dataset, truth_mesh=truth_mesh))
    traits = result_traits.read(result_folder)
    if (result_folder / "roots.rsml").is_file():
        roots = rsml.read_rsml(result_folder / "roots.rsml")
        written.append(_save(report_roots.roots_and_inputs(roots, summary, dataset), result_folder, "roots.png"))
        written.append(_save(report_roots.length_plots(traits), result_folder, "lengths.png"))
    page = result_folder / "report.html"
    atomic.write_bytes(page, _page(summary, dataset, traits, written).encode("utf-8", "backslashreplace"))
    return [*written, page]


def write_shape_and_truth(result_folder: Path, dataset: Dataset, *, truth_mesh: Path) -> Path:
    """Write ``pictures/shape_and_truth.png`` into a result folder and return its path."""
    result_folder = Path(result_folder)
    summary = result_files.read_summary(result_folder)
    shape, truth = result_files.read_mesh(result_folder / "shape.ply"), result_files.read_mesh(Path(truth_mesh))
    title = f"{summary['scene']}: {summary['volume_mm3']:.1f} mm3, voxels of {summary['voxel_mm']:g} mm"
    return _save(pictures.shape_and_truth(shape, truth, dataset.scene, title=title), result_folder, "shape_and_truth.png")


def _save(drawn: Figure, result_folder: Path, name: str) -> Path:
    path = result_folder / "pictures" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    stored = io.BytesIO()
    drawn.savefig(stored, format="png", dpi=DPI)
    atomic.write_bytes(path, stored.getvalue())
    return path


def _page(summary: Json, dataset: Dataset, traits: Traits, written: list[Path]) -> str:
    """Return the page as one self-contained text."""
    warnings = "".join(f'<p class="warning">{html.escape(str(warning))}</p>' for warning in summary["warnings"])
    of_roots = [path for path in written if path.name in ROOT_PICTURES]
    sections = {
        "Volume": report_tables.volume(summary),
        "Roots": _figures(of_roots),
        "Traits": report_tables.traits(traits),
        "Pictures": _figures([path for path in written if path not in of_roots]),
        "Numbers": report_tables.table(_numbers(summary)),
        "What the scan calibrated by itself": report_tables.calibration(summary),
        "Views": _views(summary),
        "How it was made": report_tables.table(_provenance(summary)),
    }
    body = "".join(f"<h2>{title}</h2>{text}" for title, text in sections.items() if text)
    name = html.escape(str(summary["scene"]))
    described = html.escape(dataset.scene.description)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title><style>{STYLE}</style></head><body>'
        f"<h1>Reconstruction of {name}</h1><p>{described}</p>{warnings}{body}</body></html>\n"
    )


def _figures(paths: list[Path]) -> str:
    """Return pictures with their captions, inside the page."""
    return "".join(
        f'<figure><img alt="{html.escape(path.name)}" src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}">'
        f"<figcaption>{html.escape(CAPTIONS[path.name])}</figcaption></figure>"
        for path in paths
    )


def _numbers(summary: Json) -> list[tuple[str, str]]:
    extents = [b - a for a, b in zip(summary["extents_min_mm"], summary["extents_max_mm"], strict=True)]
    used = [view for view in summary["views"] if view["used"]]
    return [
        ("Extents along x, y, z of the canister", " x ".join(f"{extent:.2f}" for extent in extents) + " mm"),
        ("Hull before trimming", f"{summary['hull_mm3']:.1f} mm³"),
        ("Part of the volume that is untrimmed hull", f"{summary['untrimmed_mm3']:.1f} mm³"),
        ("Water that too few views could see", f"{summary['blind_mm3']:.1f} mm³"),
        ("Attenuation of light in the roots", _attenuation(summary)),
        ("Voxel", f"{summary['voxel_mm']:g} mm"),
        ("Views used", f"{len(used)} of {len(summary['views'])}"),
        ("Time", ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in summary["timings_s"].items())),
    ]


def _attenuation(summary: Json) -> str:
    """Return the attenuation of light in the roots in words."""
    mu, sigma = summary.get("root_mu_per_mm"), summary.get("root_mu_sigma_per_mm")
    if mu is None:
        return "opaque"
    return f"{mu:.2f} /mm" if sigma is None else f"{mu:.2f} ± {sigma:.2f} /mm"


def _views(summary: Json) -> str:
    def number(value: float | None, digits: int, factor: float = 1.0) -> str:
        return "" if value is None else f"{factor * value:.{digits}f}"

    head = "<tr><th>file</th><th>ring</th><th>table (deg)</th><th>markers</th><th>reprojection (px)</th><th>fill (%)</th><th></th></tr>"
    rows = []
    for view in summary["views"]:
        cells = [
            number(view.get("ring"), 0),
            number(view.get("table_deg"), 2),
            number(view.get("markers"), 0),
            number(view.get("reprojection_px"), 3),
            number(view.get("fill"), 2, 100.0),
        ]
        reason = "" if view["used"] else f"left out: {view.get('reason') or 'no reason given'}"
        rows.append(
            f"<tr{'' if view['used'] else ' class=out'}><td>{html.escape(str(view['file']))}</td>"
            + "".join(f'<td class="number">{cell}</td>' for cell in cells)
            + f"<td>{html.escape(reason)}</td></tr>"
        )
    return f"<table>{head}{''.join(rows)}</table>"


def _provenance(summary: Json) -> list[tuple[str, str]]:
    rows = [("dataset", str(summary.get("dataset", "")))]
    for key, value in summary.get("settings", {}).items():
        rows += [(f"{key}.{name}", str(part)) for name, part in value.items()] if isinstance(value, dict) else [(str(key), str(value))]
    rows += [(f"version of {key}", str(value)) for key, value in summary.get("versions", {}).items()]
    return rows
