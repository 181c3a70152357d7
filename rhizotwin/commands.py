"""What each sub-command of the command line does; the work itself is in `scenes`, `sim` and `recon`."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

from rhizotwin import print_commands, rig_commands, steps, traits_commands
from rhizotwin.recon.results import calibrated
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.truth import load_truth


def run(options: argparse.Namespace) -> None:
    """Do what the parsed command line asks for."""
    handlers: dict[str, Callable[[argparse.Namespace], None]] = {
        "scenes": scenes,
        "simulate": simulate,
        "reconstruct": reconstruct,
        "import": import_,
        "score": score,
        "export": export,
        "traits": traits_commands.traits,
        "plan": plan,
        "demo": demo,
        "markers": print_commands.markers,
        "calibrate": print_commands.calibrate,
        "scan": rig_commands.scan,
        "twin": rig_commands.twin,
        "rig": rig_commands.rig,
        "camera": rig_commands.camera,
    }
    handlers[options.command](options)


def scenes(options: argparse.Namespace) -> None:
    """List the library, or write a copy of a scene's file."""
    if (options.name is None) != (options.output is None):
        raise UserError("give both a scene and -o FILE to write a copy of a scene's file, or neither to list the library")
    if options.name is not None:
        if options.output.exists():
            raise UserError(f"{options.output} exists already; choose another name")
        files.save_scene(files.load_scene(options.name), options.output)
        print(f"wrote {options.output}; change it, then try: rhizotwin simulate {options.output} -o my_dataset")
        return
    for title, rows in (("scenes", files.library()), ("profiles (simulate --profile)", files.profiles())):
        width = max((len(name) for name, _ in rows), default=0)
        print(f"{title}:")
        for name, description in rows:
            print(f"  {name:<{width}}  {description}")


def simulate(options: argparse.Namespace) -> None:
    """Render a scene to a dataset."""
    scene = steps.change_scene(
        files.load_scene(options.scene),
        specimen=options.specimen,
        specimen_unit=options.specimen_unit,
        specimen_diameter_mm=options.specimen_diameter_mm,
        views=options.views,
        image_wh=options.image_wh,
        profile=options.profile,
    )
    steps.start_engine(options)
    from rhizotwin.sim.simulate import simulate as render

    dataset = render(
        scene,
        options.output,
        profile_name=options.profile or "scene",
        seed=options.seed,
        fidelity=options.fidelity,
        samples=options.samples,
    )
    for note in load_truth(options.output).drawn["notes"]:
        print(f"note: {note}")
    print(f"{len(dataset.frames)} pictures in {options.output / 'images'}, the truth in {options.output / 'truth'}")
    print(f"next: rhizotwin reconstruct {options.output} -o my_result")


def reconstruct(options: argparse.Namespace) -> None:
    """Reconstruct a dataset to a result with its pictures."""
    steps.start_engine(options)
    written = steps.reconstruct_whole(options.dataset, options.output, voxel_mm=options.voxel_mm, mass_g=options.mass_g)
    summary = json.loads((options.output / "result.json").read_text(encoding="utf-8"))
    low, high = summary["volume_interval_mm3"]
    used = sum(view["used"] for view in summary["views"])
    for warning in summary["warnings"]:
        print(f"warning: {warning}")
    for line in calibrated.table(summary["rig"]):
        print(line)
    if summary["root_mu_per_mm"] is not None:
        sigma = summary["root_mu_sigma_per_mm"]
        print(f"translucent roots: attenuation {summary['root_mu_per_mm']:.3g}{'' if sigma is None else f' +- {sigma:.2g}'} per mm")
    print(
        f"volume {summary['volume_mm3']:.1f} mm3, 90 % interval {low:.1f} to {high:.1f} mm3; {used} of {len(summary['views'])} views used"
    )
    if summary["volume_trusted"]:
        worst = max(summary["volume_budget"], key=lambda term: max(term["less_mm3"], term["more_mm3"]), default=None)
        if worst is not None:
            print(f"most uncertain: {worst['why']} (-{worst['less_mm3']:.1f}, +{worst['more_mm3']:.1f} mm3)")
    _print_paths(written)
    if (options.dataset / "truth").is_dir():
        print(f"next: rhizotwin score {options.output} {options.dataset}")


def import_(options: argparse.Namespace) -> None:
    """Make a dataset of a folder of pictures."""
    from rhizotwin.importer import import_pictures

    scene = files.load_scene(options.scene)
    made = import_pictures(options.pictures, scene, options.output, cameras=options.cameras, masks=options.masks)
    for note in made.notes:
        print(f"note: {note}")
    print(f"{len(made.dataset.frames)} pictures in {options.output}")
    print(f"next: rhizotwin reconstruct {options.output} -o my_result")


def score(options: argparse.Namespace) -> None:
    """Print how well a result agrees with the truth."""
    from rhizotwin.recon.scoring.score import score as compare

    found = compare(options.result, options.dataset)
    print(json.dumps(found.to_dict(), indent=1) if options.json else found.table())


def export(options: argparse.Namespace) -> None:
    """Write a result in the form of another program."""
    from rhizotwin import exports

    print(exports.describe(exports.export(options.result, options.output, dataset_folder=options.dataset, roots=options.roots)))


def plan(options: argparse.Namespace) -> None:
    """Try capture plans on the twin."""
    from rhizotwin import planning, plans

    scene = steps.change_scene(files.load_scene(options.scene), profile=options.profile)
    first_mm = scene.plan.rings[0].height_mm
    asked = [tuple(plans.Height(mm, tilt_deg) for mm, tilt_deg in rings) for rings in options.heights or []]
    own = plans.Height(first_mm)
    heights = asked or [(own,), (own, plans.Height(first_mm + planning.SECOND_RING_MM))]
    variants = [
        plans.Variant(heights=rings, views=views, image_wh=image_wh)
        for image_wh in options.image_wh or (scene.camera.image_wh,)
        for rings in dict.fromkeys(heights)
        for views in options.views
    ]
    steps.start_engine(options)
    rows = planning.run_plans(scene, variants, options.output, profile_name=options.profile, seeds=options.seeds, say=print)
    chosen = planning.best(rows, within=options.within / 100.0)
    if chosen is None:
        print(f"no plan stays within {options.within:g} % of the volume; try more views, pixels or rings")
    else:
        print(f"cheapest plan within {options.within:g} %: {chosen.variant.name}, {chosen.pictures} pictures")
    print(f"picture: {options.output / 'plan.png'}; numbers: {options.output / 'plan.csv'}")


def demo(options: argparse.Namespace) -> None:
    """Simulate, reconstruct and score a small printed root."""
    from rhizotwin.demo import demo as run_demo

    steps.start_engine(options)
    run_demo(options.output, profile=options.profile, say=print)


def _print_paths(paths: list[Path]) -> None:
    print("pictures to look at:")
    for path in paths:
        print(f"  {path}")
