"""Collision checks of arm paths against the canister, net pot, table, tank, floor and bars.

The arm is modelled by capsules, and the camera by a sphere. Obstacles are cylinders, boxes and a half-space. Between
two configurations, no point of a link moves farther than the sum, over the joints, of the joint's rotation times the
length of the arm beyond it. A segment of a path is clear if the clearance at its midpoint exceeds half of this
distance; otherwise the segment is bisected. Thus no collision between samples can be missed, regardless of the length
of the segment.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.arm.kinematics import places, rig_from_arm
from rhizotwin.rig.arm.placement import Joints, require_arm
from rhizotwin.rig.arm.solids import Box, Cylinder, Floor, Solid, minimum_distance, point_to_segment
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene, Tank

TABLE_THICKNESS_MM = 20.0
"""Thickness of the turntable's disc, on which the canister stands, mm."""
FINE_MM = 0.1
"""Length at which the bisection of a path segment ends, mm. A segment is not divided further if the arm moves by at
most this length between its middle and its ends, so that the distances to obstacles are checked with this accuracy."""
START_SLACK_MM = 2.0
"""Maximum distance by which the arm may come nearer to an obstacle while it moves away from its initial position, mm.
It applies only if the initial position is closer to the obstacle than the required clearance, because the arm has
sagged or was pushed."""


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Distances between the parts of the arm and the obstacles.

    There are N configurations of the arm, and P pairs of a part and an obstacle.
    """

    names: tuple[tuple[str, str], ...]
    """For each pair, the name of the arm's part and the name of the obstacle."""
    distance_mm: Array
    """Distance between the part and the obstacle, shape (N, P)."""
    margin_mm: Array
    """Minimum distance that is required for each pair, shape (P,)."""
    travel_mm: Array
    """Upper bound of the decrease of each distance when a joint rotates by 1 rad, shape (P, 5)."""
    floor: NDArray[np.bool_]
    """Whether the obstacle of each pair is the floor, shape (P,). An arm without torque may lie on the floor."""


def solids(rig: RigFile, scene: Scene) -> list[Solid]:
    """Return the obstacles of the arm as solids in the rig frame."""
    canister, pot, clearance = scene.canister, scene.net_pot, rig.clearance
    under = -canister.height_mm
    return [
        Cylinder("canister", canister.outer_radius_mm, under, 0.0),
        Cylinder("net pot", pot.outer_radius_mm, pot.skirt_bottom_mm, pot.top_mm),
        Cylinder("table", clearance.table_radius_mm, under - TABLE_THICKNESS_MM, under),
        *([] if scene.tank is None else [_tank(scene.tank, clearance.floor_z_mm)]),
        Floor("floor", clearance.floor_z_mm),
        *(Box(f"bar {i + 1}", bar.low_mm, bar.high_mm) for i, bar in enumerate(clearance.bars)),
    ]


def _tank(tank: Tank, floor_z_mm: float) -> Box:
    """Return the bounding box of a tank, which may be rotated about the vertical axis.

    It extends from the tank's rim to the floor, and thus includes the stand.
    """
    turn = np.deg2rad(abs(tank.turn_deg))
    x = tank.front_mm * np.cos(turn) + tank.half_width_mm * np.sin(turn)
    y = tank.half_width_mm * np.cos(turn) + tank.front_mm * np.sin(turn)
    return Box("tank", (-x, -y, floor_z_mm), (x, y, tank.level_mm))


def pairs(rig: RigFile, scene: Scene, joints_deg: Array) -> Pairs:
    """Compute the distances between all parts of the arm and all obstacles at joint angles (N, 5), deg.

    The base column is fixed to the floor or a bar, and is therefore checked only against the canister, net pot, table
    and camera. No clearance is required between parts of the arm, since they do not sag relative to each other.

    Parameters
    ----------
    rig : RigFile
        Arm, clearances and obstacles.
    scene : Scene
        Scene with canister, net pot and tank.
    joints_deg : (N, 5) array
        Configurations of the arm.

    Returns
    -------
    Pairs
        Distances of every pair, and their names.
    """
    part, clearance = require_arm(rig), rig.clearance
    at = frames.apply(rig_from_arm(part), places(part.links_mm, np.deg2rad(joints_deg)))
    _, upper, fore, hand = part.links_mm
    width, sphere = clearance.arm_radius_mm, clearance.camera_radius_mm
    swing = (upper + fore + hand, upper + fore + hand, fore + hand, hand, 0.0)
    pieces = (
        ("base", width, (0.0,) * 5),
        ("upper arm", width, (upper, upper, 0.0, 0.0, 0.0)),
        ("forearm", width, (upper + fore, upper + fore, fore, 0.0, 0.0)),
        ("last link", width, swing),
        ("camera", sphere, swing),
    )
    names, distances, margins, travels, floor = [], [], [], [], []
    for solid in solids(rig, scene):
        axis_mm = minimum_distance(solid, at[:, [0, 1, 2, 3, 4]], at[:, [1, 2, 3, 4, 4]])
        for k, (piece, radius, travel) in enumerate(pieces):
            if piece == "base" and not isinstance(solid, Cylinder):
                continue
            names.append((piece, f"the {solid.name}"))
            distances.append(axis_mm[:, k] - radius)
            margins.append(clearance.margin_mm)
            travels.append(travel)
            floor.append(isinstance(solid, Floor))
    for k, own, travel in ((0, "base", (0.0, *swing[1:])), (1, "upper arm", (0.0, 0.0, *swing[2:]))):
        names.append(("camera", f"the arm's own {own}"))
        distances.append(point_to_segment(at[:, 4], at[:, k], at[:, k + 1]) - sphere - width)
        margins.append(0.0)
        travels.append(travel)
        floor.append(False)
    return Pairs(
        names=tuple(names),
        distance_mm=np.stack(distances, axis=-1),
        margin_mm=np.array(margins),
        travel_mm=np.array(travels),
        floor=np.array(floor),
    )


def check_path(rig: RigFile, scene: Scene, joints_path_deg: Sequence[Joints]) -> None:
    """Raise an error if the arm comes closer to an obstacle than the required clearance.

    The path is piecewise linear in the joint angles. The first configuration may be closer to an obstacle, provided
    that the arm touches nothing but the floor and moves away. All other configurations must have the clearance.

    Parameters
    ----------
    rig : RigFile
        Arm, clearances and obstacles.
    scene : Scene
        Scene with canister, net pot and tank.
    joints_path_deg : sequence of Joints
        Configurations, starting with the present configuration.

    Raises
    ------
    UnsafeError
        If a margin is violated; the message states the part, the obstacle, the distance and the position along the
        path.
    """
    path = np.array(joints_path_deg, dtype=float).reshape(-1, 5)
    here = pairs(rig, scene, path)
    start = here.distance_mm[0]
    least = np.where(here.floor, -rig.clearance.arm_radius_mm, 0.0)
    if (start < least).any():
        raise _refusal(here, start - least, "in its present position", least, remedy="move it away by hand with the torque off")
    slack = np.minimum(here.margin_mm, np.maximum(start - START_SLACK_MM, least))
    for k in range(1, len(path)):
        if (here.distance_mm[k] < here.margin_mm).any():
            where = "at the end of the path" if k == len(path) - 1 else f"at configuration {k} of the path"
            raise _refusal(here, here.distance_mm[k] - here.margin_mm, where, here.margin_mm)
        _check_between(rig, scene, path[k - 1], path[k], slack if k == 1 else here.margin_mm, (k - 1, len(path) - 1))


def plan_path(rig: RigFile, scene: Scene, start_deg: Joints, goal_deg: Joints) -> list[Joints]:
    """Return the configurations of a collision-free path, in order, with the goal last.

    The direct path is used if it is clear. Otherwise the path passes through retracted configurations.

    Parameters
    ----------
    rig : RigFile
        Arm, clearances and obstacles.
    scene : Scene
        Scene with canister, net pot and tank.
    start_deg, goal_deg : Joints
        Present and final configuration.

    Returns
    -------
    list of Joints
        Configurations of the path, without the start.

    Raises
    ------
    UnsafeError
        If neither the direct path nor any detour is clear; the message states the obstacle on the direct path.
    """
    try:
        check_path(rig, scene, [start_deg, goal_deg])
    except UnsafeError as error:
        for between in _detours(rig, start_deg, goal_deg):
            path = [*between, tuple(goal_deg)]
            if _is_clear(rig, scene, [start_deg, *path]):
                return path
        raise UnsafeError(f"{error}; a path with a retracted arm is not clear either") from error
    return [tuple(goal_deg)]


def _detours(rig: RigFile, start_deg: Joints, goal_deg: Joints) -> list[list[Joints]]:
    """Return candidate paths that avoid the direct connection.

    One passes through the parking position. In the others the base rotates while the arm is retracted or raised.
    """
    part = require_arm(rig)
    rest = tuple(part.park_deg)
    found: list[list[Joints]] = [[rest]]
    for shape in (rest[1:4], (0.0, 0.0, 0.0)):
        if all(joint.min_deg <= angle <= joint.max_deg for joint, angle in zip(part.joints[1:4], shape, strict=True)):
            found.append([(start_deg[0], *shape, start_deg[4]), (goal_deg[0], *shape, goal_deg[4])])
    return found


def _is_clear(rig: RigFile, scene: Scene, path_deg: Sequence[Joints]) -> bool:
    try:
        check_path(rig, scene, path_deg)
    except UnsafeError:
        return False
    return True


def _check_between(rig: RigFile, scene: Scene, begin_deg: Array, end_deg: Array, keep_mm: Array, leg: tuple[int, int]) -> None:
    """Check the segment between two configurations by bisection.

    The distances must be at least ``keep_mm`` everywhere on the segment.
    """
    step_deg = end_deg - begin_deg
    middles, half = np.array([0.5]), 0.5
    while len(middles):
        here = pairs(rig, scene, begin_deg + middles[:, None] * step_deg)
        spare = here.distance_mm - keep_mm
        if (spare < 0.0).any():
            worst = int(spare.min(axis=1).argmin())
            percent = 100.0 * (leg[0] + middles[worst]) / leg[1]
            raise _refusal(here, spare[worst], f"{percent:.0f} % along the path", keep_mm)
        travel = half * here.travel_mm @ np.abs(np.deg2rad(step_deg))
        unsure = ((spare < travel) & (travel > FINE_MM)).any(axis=1)
        half /= 2.0
        middles = np.concatenate([middles[unsure] - half, middles[unsure] + half])


def _refusal(
    here: Pairs,
    spare_mm: Array,
    where: str,
    keep_mm: Array | float,
    *,
    remedy: str = "move the ring, the arm or the obstacle",
) -> UnsafeError:
    k = int(spare_mm.argmin())
    piece, other = here.names[k]
    keep = float(np.broadcast_to(keep_mm, spare_mm.shape)[k])
    distance = float(spare_mm[k]) + keep
    how = f"would touch {other}" if distance <= 0.0 else f"would come within {distance:.1f} mm of {other} (minimum {keep:.0f} mm)"
    return UnsafeError(f"arm: the {piece} {how} {where}; {remedy}")
