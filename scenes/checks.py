"""Consistency checks of a scene.

The parts of the rig must fit together, and match the camera model.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Camera, Ring, Scene, Tank
from rhizotwin.scenes.plants import check_plants
from rhizotwin.scenes.schema import Place, suggestion
from rhizotwin.scenes.solution import check_solution
from rhizotwin.scenes.specimens import GrownSpecimen, Specimen, SphereSpecimen
from rhizotwin.scenes.subject import check_subject

TELECENTRIC_TILT_DEG = 1.5
"""Maximum tilt of a telecentric camera, deg. Up to this tilt, the pinhole model of the camera (`model.FAR_MM`) is exact
to 1e-4 mm in single precision."""

POT_RATIO = 2.0
"""Maximum ratio of the radii of net pot and canister. The pot's skirt encloses the canister with a gap of millimetres
(3.4 mm in the thesis), whereas slips of units are factors of ten and more."""
FARTHEST_MM = 3000.0
"""Largest distance of a camera or panel that is suggested instead of a distance in another unit. Rigs are smaller."""


def check_scene(scene: Scene, *, where: str = "scene", text: str = "") -> None:
    """Check that the values of a scene are consistent with each other.

    Parameters
    ----------
    scene : Scene
        Scene to check. Each value is assumed to be within its own limits.
    where : str
        Name of the file or other origin, used in messages.
    text : str
        TOML text of the file, used to determine the number of the invalid line.

    Raises
    ------
    UserError
        If values are inconsistent; the message states the first inconsistent value.
    """
    place = Place(where, text)
    check_subject(scene.subject, place.at("subject"))
    check_solution(scene.solution, place.at("solution"))
    _check_canister(scene, place)
    _check_tank(scene, place)
    _check_strip(scene, place)
    _check_camera(scene.camera, scene, place)
    _check_bands(scene, place)
    _check_plan(scene, place)
    check_plants(scene.plants, scene.subject, radius_mm=scene.canister.inner_radius_mm, place=place)
    if scene.specimen is not None and scene.plants:
        raise place.at("specimen").error("must be omitted if there are [[plants]], because each plant has its own [plants.specimen]")
    _check_specimen(scene.specimen, scene, place.at("specimen"))
    for number, plant in enumerate(scene.plants):
        _check_specimen(plant.placed(), scene, place.at("plants", number, "specimen"))


def _unit_slip(value: float, low_mm: float, high_mm: float) -> str:
    """Return a hint if a length would be between two limits if it were in another unit, or else an empty text."""
    units = {"centimetres": 10.0, "inches": 25.4, "metres": 1000.0}
    fitting = [f"{value:g} {unit} are {value * mm:g} mm" for unit, mm in units.items() if low_mm < value * mm < high_mm]
    return f" ({' and '.join(fitting)}; give millimetres)" if fitting else ""


def _check_canister(scene: Scene, place: Place) -> None:
    canister, pot, water = scene.canister, scene.net_pot, scene.water
    least_mm = pot.outer_radius_mm / POT_RATIO
    if canister.outer_radius_mm < least_mm:
        slip = _unit_slip(canister.outer_radius_mm, least_mm, pot.outer_radius_mm)
        held = f"the canister holds the net pot, whose outer_radius_mm is {pot.outer_radius_mm:g}"
        must = f"must be at least {least_mm:.4g}, because {held}{slip}"
        raise place.at("canister", "outer_radius_mm").error(must, canister.outer_radius_mm)
    if canister.inner_radius_mm <= 0.0:
        raise place.at("canister", "wall_mm").error(f"must be below outer_radius_mm, {canister.outer_radius_mm:g}", canister.wall_mm)
    if canister.half_width_mm is not None:
        _check_rectangle(scene, canister.half_width_mm, place)
    if canister.base_mm >= canister.height_mm:
        raise place.at("canister", "base_mm").error(f"must be below height_mm, {canister.height_mm:g}", canister.base_mm)
    if water.level_mm <= canister.floor_z_mm:
        must = f"must be above the canister's floor at z = base_mm - height_mm = {canister.floor_z_mm:g}"
        raise place.at("water", "level_mm").error(must, water.level_mm)
    if pot.outer_radius_mm <= canister.outer_radius_mm:
        must = f"must be above outer_radius_mm of the canister, {canister.outer_radius_mm:g}, because the skirt encloses the canister"
        must += _unit_slip(pot.outer_radius_mm, canister.outer_radius_mm, POT_RATIO * canister.outer_radius_mm)
        raise place.at("net_pot", "outer_radius_mm").error(must, pot.outer_radius_mm)
    if pot.top_mm <= max(pot.skirt_bottom_mm, 0.0):
        must = f"must be above skirt_bottom_mm, {pot.skirt_bottom_mm:g}, and above the canister's rim at 0"
        raise place.at("net_pot", "top_mm").error(must, pot.top_mm)
    if pot.grid_z_mm <= canister.floor_z_mm:
        raise place.at("net_pot", "grid_z_mm").error(f"must be above the canister's floor at z = {canister.floor_z_mm:g}", pot.grid_z_mm)
    if pot.skirt_bottom_mm <= -canister.height_mm:
        must = f"must be above the canister's underside at z = {-canister.height_mm:g}"
        raise place.at("net_pot", "skirt_bottom_mm").error(must, pot.skirt_bottom_mm)
    wrong = scene.disturbances
    if canister.inner_radius_mm + wrong.canister_radius_error_mm - canister.wall_mm * wrong.wall_error <= 0.0:
        raise place.at("disturbances", "wall_error").error(
            "must be smaller, because with walls of this thickness the canister would have no interior", wrong.wall_error
        )
    reach_mm = canister.outer_radius_mm + wrong.canister_radius_error_mm + wrong.canister_out_of_round_mm
    if reach_mm >= pot.outer_radius_mm:
        must = (
            f"must be smaller, because the true canister's radius of {reach_mm:g} mm would exceed the net pot's {pot.outer_radius_mm:g} mm"
        )
        raise place.at("disturbances", "canister_radius_error_mm").error(must, wrong.canister_radius_error_mm)
    if wrong.root_n is not None and wrong.root_mu_per_mm is None:
        raise place.at("disturbances", "root_n").error("requires root_mu_per_mm, because refracting roots transmit light", wrong.root_n)
    true_index = water.n_water + scene.disturbances.n_water_error
    if true_index < 1.0:
        must = f"must be larger, because the water's true refractive index would be {true_index:g} (n_water is {water.n_water:g}), below 1"
        raise place.at("disturbances", "n_water_error").error(must, scene.disturbances.n_water_error)


def _check_rectangle(scene: Scene, half_width_mm: float, place: Place) -> None:
    canister, wrong, here = scene.canister, scene.disturbances, place.at("canister", "half_width_mm")
    if half_width_mm < canister.outer_radius_mm:
        raise here.error(f"must be at least outer_radius_mm, {canister.outer_radius_mm:g}; exchange the two values", half_width_mm)
    if math.hypot(half_width_mm, canister.outer_radius_mm) >= scene.net_pot.outer_radius_mm:
        most_mm = math.sqrt(max(scene.net_pot.outer_radius_mm**2 - canister.outer_radius_mm**2, 0.0))
        raise here.error(f"must be below {most_mm:.4g}, so that the net pot's skirt encloses the corners", half_width_mm)
    if scene.tank is not None:
        raise here.error("cannot be combined with a [tank]", half_width_mm)
    on_wall = ("canister_out_of_round_mm", "algae_patches", "bubbles", "dust_specks", "scratches", "seam_opacity")
    if dirty := [name for name in on_wall if getattr(wrong, name)]:
        raise here.error(f"cannot be combined with disturbances of a round wall; set {', '.join(dirty)} to 0", half_width_mm)


def _check_tank(scene: Scene, place: Place) -> None:
    tank = scene.tank
    if tank is None:
        return
    here, wrong, pot = place.at("tank"), scene.disturbances, scene.net_pot
    reach_mm = scene.canister.outer_radius_mm + wrong.canister_radius_error_mm + wrong.canister_out_of_round_mm
    reach_mm += wrong.canister_offset_mm + math.tan(math.radians(wrong.canister_tilt_deg)) * scene.canister.height_mm
    for name in ("front_mm", "half_width_mm"):
        if getattr(tank, name) - tank.wall_mm <= reach_mm:
            raise here.at(name).error(
                f"must be above {reach_mm + tank.wall_mm:.4g}, so that the canister can rotate within the tank's walls", getattr(tank, name)
            )
    if tank.level_mm >= pot.skirt_bottom_mm:
        raise here.at("level_mm").error(
            f"must be below skirt_bottom_mm of the net pot, {pot.skirt_bottom_mm:g}, because the strip must be above the liquid",
            tank.level_mm,
        )
    if tank.level_mm <= scene.canister.floor_z_mm:
        raise here.at("level_mm").error(f"must be above the canister's floor at z = {scene.canister.floor_z_mm:g}", tank.level_mm)
    turn = math.radians(abs(tank.turn_deg))
    if tank.front_mm * math.cos(turn) + tank.half_width_mm * math.sin(turn) >= scene.lights.backlight_distance_mm:
        must = f"must be below lights.backlight_distance_mm, {scene.lights.backlight_distance_mm:g}, because the panel is behind the tank"
        raise here.at("front_mm").error(must, tank.front_mm)
    for i, ring in enumerate(scene.plan.rings):
        if ring.distance_mm <= tank.front_mm:
            must = f"must be above tank.front_mm, {tank.front_mm:g}, because the camera is in front of the tank"
            raise place.at("plan", "rings", i, "distance_mm").error(must, ring.distance_mm)
        _check_strip_above(scene, tank, ring, place.at("plan", "rings", i, "height_mm"))
    if scene.surroundings.n > 1.0 or scene.camera.kind != "pinhole":
        raise here.at("front_mm").error("requires a pinhole camera in air; set surroundings.n to 1 and camera.kind to pinhole")
    if wrong.seam_opacity or wrong.dust_specks or wrong.scratches or wrong.highlight:
        raise here.at("front_mm").error(
            "cannot be combined with a dirty canister; set dust_specks, scratches, seam_opacity and highlight of disturbances to 0"
        )


def _check_strip_above(scene: Scene, tank: Tank, ring: Ring, here: Place) -> None:
    """Reject a camera position from which the strip is seen through the liquid in the tank.

    It must be seen through air.
    """
    strip_mm, low_mm = scene.net_pot.outer_radius_mm, scene.strip.bottom_mm
    least_mm = low_mm + (tank.level_mm - low_mm) * (ring.distance_mm - strip_mm) / (tank.front_mm - strip_mm)
    if scene.strip.rows and tank.front_mm > strip_mm and ring.height_mm < least_mm:
        must = f"must be above {least_mm:.4g}, because from a lower position the strip's lower edge is behind the tank's liquid (level_mm)"
        raise here.error(must, ring.height_mm)


def _check_strip(scene: Scene, place: Place) -> None:
    strip, pot = scene.strip, scene.net_pot
    if strip.rows == 0:
        return
    import cv2  # imported here: loading takes half a second, and many scenes have no strip

    from rhizotwin.scenes.markers import strip_ids

    here = place.at("strip")
    known = [name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")]
    if strip.dictionary not in known:
        near = suggestion(strip.dictionary, known) or f"; known dictionaries are {', '.join(known)}"
        raise here.at("dictionary").error(f"is not a marker dictionary of OpenCV{near}", strip.dictionary)
    try:
        strip_ids(strip)
    except UserError as error:
        raise here.at("dictionary").error(str(error), strip.dictionary) from None
    pitch_mm = 2.0 * math.pi * pot.outer_radius_mm / strip.columns
    if strip.marker_mm >= pitch_mm:
        must = f"must be below {pitch_mm:.4g} mm, the width of each of the {strip.columns} columns on the net pot's circumference"
        raise here.at("marker_mm").error(must, strip.marker_mm)
    if strip.rows > 1 and strip.row_pitch_mm <= strip.marker_mm:
        raise here.at("row_pitch_mm").error(f"must be above marker_mm, {strip.marker_mm:g}", strip.row_pitch_mm)
    top_mm = strip.bottom_mm + (strip.rows - 1) * strip.row_pitch_mm + strip.marker_mm
    if strip.bottom_mm < pot.skirt_bottom_mm or top_mm > pot.top_mm:
        must = (
            f"places the markers between z = {strip.bottom_mm:g} and {top_mm:g}, but the net pot's skirt extends only "
            f"from {pot.skirt_bottom_mm:g} to {pot.top_mm:g}; move the strip or change net_pot"
        )
        raise here.at("bottom_mm").error(must, strip.bottom_mm)


def _check_camera(camera: Camera, scene: Scene, place: Place) -> None:
    table = camera.transfer_table
    if (camera.transfer == "table") != bool(table):
        raise place.at("camera", "transfer").error(
            'must agree with transfer_table, which is required for "table" and not permitted otherwise', camera.transfer
        )
    if table and (len(table) < 2 or any(b < a for a, b in pairwise(table)) or not table[0] < table[-1]):
        raise place.at("camera", "transfer_table").error("must have at least two numbers, which increase from dark to bright")
    if camera.kind == "pinhole" and scene.surroundings.n > 1.0:
        must = 'must be 1 (air) unless camera.kind is "telecentric", because only parallel rays pass a flat window without refraction'
        raise place.at("surroundings", "n").error(must, scene.surroundings.n)
    for index, ring in enumerate(scene.plan.rings):
        if camera.kind == "telecentric" and abs(ring.tilt_deg) > TELECENTRIC_TILT_DEG:
            must = f"must be at most {TELECENTRIC_TILT_DEG:g} degrees up or down for a telecentric camera"
            raise place.at("plan", "rings", index, "tilt_deg").error(must, ring.tilt_deg)
    for axis, (centre, size) in enumerate(zip(camera.principal_px, camera.image_wh, strict=True)):
        if not -size <= centre <= 2 * size:
            must = f"must be at most one picture size ({size} px) outside the picture"
            raise place.at("camera", "principal_px", axis).error(must, centre)
    own, extra = camera.distortion, scene.disturbances.distortion
    _check_distortion(camera, own, place.at("camera", "distortion"))
    if any(extra):
        _check_distortion(camera, [a + b for a, b in zip(own, extra, strict=True)], place.at("disturbances", "distortion"))


def _check_bands(scene: Scene, place: Place) -> None:
    """Check the names of the bands. Each ring must have a band in which both lights are on."""
    names = [band.name for band in scene.camera.bands]
    for i, name in enumerate(names):
        if not (name.isascii() and name.isidentifier() and name == name.lower()) or name in names[:i]:
            raise place.at("camera", "bands", i, "name").error("must be one lower-case word, and unique", name)
    lit = {name for name in names if scene.is_lit(name)}
    for i, ring in enumerate(scene.plan.rings):
        here = place.at("plan", "rings", i, "bands")
        for j, name in enumerate(ring.bands):
            if name not in names or name in ring.bands[:j]:
                must = f"must be different bands of the camera, which are {', '.join(names)}" if names else "requires [[camera.bands]]"
                raise here.error(must, name)
        if names and not lit & set(ring.bands or names):
            raise here.error(
                "must include a band in which panel and front light are on, because outlines and markers must be visible", list(ring.bands)
            )
    if scene.shoot is not None:
        _check_spectrum(scene.shoot.spectrum, place.at("shoot", "spectrum"))


def _check_spectrum(spectrum: tuple[tuple[float, float], ...], place: Place) -> None:
    if not spectrum or any(not 0.0 <= share <= 1.0 for _, share in spectrum):
        raise place.error("must be pairs of a wavelength in nm and a reflectance from 0 to 1", spectrum)
    if any(low[0] >= high[0] for low, high in pairwise(spectrum)):
        raise place.error("must have increasing wavelengths", spectrum)


def _check_distortion(camera: Camera, distortion: Sequence[float], place: Place) -> None:
    """Reject a lens distortion that folds before it reaches the corners of the picture."""
    from rhizotwin.scenes.lens import fold_r2

    k1, k2, _, _, k3 = distortion
    sides = [max(c, n - 1 - c) / f for c, n, f in zip(camera.principal_px, camera.image_wh, camera.focal_px, strict=True)]
    r2 = fold_r2(distortion)
    if math.isfinite(r2) and math.sqrt(r2) * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) < math.hypot(*sides):
        must = "is not monotonic up to the corners of the picture; check the signs, and the order k1, k2, p1, p2, k3"
        raise place.error(must, list(distortion))


def _check_plan(scene: Scene, place: Place) -> None:
    if not scene.plan.rings:
        raise place.at("plan", "rings").error("must have at least one entry [[plan.rings]]")
    around_mm = scene.net_pot.outer_radius_mm + scene.disturbances.canister_offset_mm
    for i, ring in enumerate(scene.plan.rings):
        if ring.distance_mm - 5.0 * ring.jitter_mm <= around_mm:
            spread = " less five times jitter_mm" if ring.jitter_mm else ""
            must = f"must{spread} be above {around_mm:g}, because the camera must be outside the canister and the net pot"
            must += _unit_slip(ring.distance_mm, around_mm, FARTHEST_MM)
            raise place.at("plan", "rings", i, "distance_mm").error(must, ring.distance_mm)
    if scene.lights.backlight_distance_mm <= around_mm:
        must = f"must be above {around_mm:g}, because the panel must be outside the canister and the net pot"
        must += _unit_slip(scene.lights.backlight_distance_mm, around_mm, FARTHEST_MM)
        raise place.at("lights", "backlight_distance_mm").error(must, scene.lights.backlight_distance_mm)
    front_x_mm, front_z_mm = scene.lights.front_xz_mm
    if abs(front_x_mm) <= around_mm and -scene.canister.height_mm <= front_z_mm <= scene.net_pot.top_mm:
        raise place.at("lights", "front_xz_mm").error("must be outside the canister and the net pot", list(scene.lights.front_xz_mm))


def _check_specimen(specimen: Specimen | None, scene: Scene, here: Place) -> None:
    canister = scene.canister
    top_mm = min(scene.water.level_mm, scene.net_pot.grid_z_mm)
    if isinstance(specimen, SphereSpecimen):
        x, y, z = specimen.centre_mm
        radius = specimen.diameter_mm / 2.0
        reach = math.hypot(x, y) + radius
        if reach >= canister.inner_radius_mm or z - radius <= canister.floor_z_mm or z + radius >= top_mm:
            must = (
                f"must be within the water, with diameter_mm {specimen.diameter_mm:g}: within {canister.inner_radius_mm:g} mm of the "
                "axis, "
                f"between z = {canister.floor_z_mm:g} (floor) and {top_mm:g} (grid or water level)"
            )
            raise here.at("centre_mm").error(must, list(specimen.centre_mm))
    if isinstance(specimen, GrownSpecimen):
        if not specimen.orders:
            raise here.at("orders").error("must have at least one entry [[specimen.orders]], for the taproot")
        x, y, z = specimen.origin_mm
        if math.hypot(x, y) >= canister.inner_radius_mm or not canister.floor_z_mm < z < top_mm:
            must = (
                f"must be within the water: within {canister.inner_radius_mm:g} mm of the axis, "
                f"between z = {canister.floor_z_mm:g} (floor) and {top_mm:g} (grid or water level)"
            )
            raise here.at("origin_mm").error(must, list(specimen.origin_mm))
