"""True state of the devices, from which the twin's pictures are computed.

The frames are those of `scenes.frames`.
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from rhizotwin.rig.arm import kinematics
from rhizotwin.rig.rig_file import ArmPart, Joint, RigFile
from rhizotwin.rig.twin.imperfections import Imperfections
from rhizotwin.rig.twin.lamps import Lamp
from rhizotwin.rig.twin.servo import Servo, Supply
from rhizotwin.rig.twin.stepper import Stepper
from rhizotwin.rig.twin.swing import Swing
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.model import Scene

# One number per device: the second key of its random streams. Those of `sim.world` are below 100.
_SERVO, _SUPPLY, _TABLE, _LAMP, _START = 101, 102, 103, 104, 105

FILTER_DEG = 5.0
"""Maximum deviation of the filter wheel from the angle of a band, deg, at which the filter still covers the light
path."""
GRIPPER = 1
GRIPPER_CELSIUS = 47.0
_MASSES = np.array([0.06, 0.06, 0.12])
"""Masses at the elbow, wrist and camera in that order, kg."""
_FALLING_STEP_S = 0.02


@dataclass(frozen=True, kw_only=True)
class Sight:
    """True state of the rig from which a picture is computed."""

    cam_from_rig: frames.Array
    rig_from_canister: frames.Array
    table_deg: float
    """True table angle, deg. The table angle does not include the offset and tilt of the canister."""
    panel: float
    front: float
    """Levels of the panel and the front light, relative to those of the scene."""
    exposure: float = 1.0
    """Product of the exposure time and the gain, relative to its nominal value."""
    band: str = ""
    """Name of the band to which the lamps and the filter are set. It is empty if they match no band."""
    twist_deg: float = 0.0
    """Twist of the lowest root tips relative to the pot, deg. It decreases linearly to 0 at the top of the roots."""

    @property
    def place_key(self) -> bytes:
        """Digest of the poses of the camera and the canister, and of the twist of the roots.

        All values are rounded to six decimals (mm, deg).
        """
        return _digest(self.cam_from_rig, self.rig_from_canister, *self._twist)

    @property
    def key(self) -> bytes:
        """Digest of all values that determine the picture."""
        band = np.frombuffer(self.band.encode(), np.uint8).astype(np.float64)
        return _digest(self.cam_from_rig, self.rig_from_canister, np.array([self.panel, self.front, self.exposure]), *self._twist, band)

    @property
    def _twist(self) -> list[frames.Array]:
        """Twist of the roots, deg.

        The list is empty if the roots are at rest, so that the digest of a picture at rest does not depend on the
        twist.
        """
        return [np.array([self.twist_deg])] if self.twist_deg else []


class TwinWorld:
    """True state of the table, the arm and the lamps.

    Parameters
    ----------
    scene
        Scene with strip, canister and plan.
    rig
        Rig file with the nominal devices.
    seed
        Random seed of all errors.
    imperfections
        Magnitudes of the errors of the devices.
    table_from_canister
        True pose of the canister relative to the table, 4x4.
    """

    def __init__(self, scene: Scene, rig: RigFile, *, seed: int, imperfections: Imperfections, table_from_canister: frames.Array) -> None:
        self.scene = scene
        self.rig = rig
        self.table_from_canister = table_from_canister
        self.tripod_cam_from_rig = plan.views(scene)[0].cam_from_rig
        """True transform ``cam_from_rig`` of the camera on its tripod, 4x4. It is used only for a rig without an
        arm."""
        self.table = Stepper(full_step_deg=rig.turntable.full_step_deg, imperfections=imperfections, key=(seed, _TABLE))
        self.swing = Swing(hz=imperfections.swing_hz, damping=imperfections.swing_damping)
        self._table_start_deg = float(np.random.default_rng([seed, _START]).uniform(0.0, 360.0))
        lights = rig.lights
        self.panel = Lamp(full_rgb=lights.panel_rgb, imperfections=imperfections, key=(seed, _LAMP, 0))
        self.front = Lamp(full_rgb=lights.front_rgb, imperfections=imperfections, key=(seed, _LAMP, 1))
        self.outputs_on: set[int] = set()
        """Numbers of the outputs of the board that are switched on."""
        self.supply = Supply(key=(seed, _SUPPLY))
        self.servos: dict[int, Servo] = {}
        if rig.arm is not None:
            for joint, rest_deg in _rest(rig):
                start = _counts(joint, rest_deg)
                self.servos[joint.servo] = Servo(start_counts=start, imperfections=imperfections, key=(seed, _SERVO, joint.servo))
            for servo in {GRIPPER, *(() if rig.arm.filter is None else (rig.arm.filter.servo,))} - self.servos.keys():
                self.servos[servo] = Servo(start_counts=500.0, imperfections=imperfections, key=(seed, _SERVO, servo))
                self.servos[servo].heat(GRIPPER_CELSIUS)
            self._weigh()

    def lamp(self, strip: int) -> Lamp:
        """Return the lamp that is connected to the given strip output of the board."""
        return self.panel if strip == self.rig.lights.panel_strip else self.front

    def advance(self, dt_s: float) -> None:
        """Advance all devices by a time step (s)."""
        for piece in self.table.motion(dt_s):
            self.swing.turn(*piece)
        self.table.advance(dt_s)
        self.panel.advance(dt_s)
        self.front.advance(dt_s)
        if not self.servos:
            return
        left_s = dt_s
        while left_s > 0.0:
            falling = any(servo.falls for servo in self.servos.values())
            step_s = min(left_s, _FALLING_STEP_S) if falling else left_s
            for servo in self.servos.values():
                servo.advance(step_s)
            self._weigh()
            left_s -= step_s
        self.supply.advance(dt_s)
        self.supply.load_volt = 0.08 * sum(servo.moving for servo in self.servos.values())

    def brown_out(self, for_s: float) -> None:
        """Let the voltage of the arm's supply drop for the given time in seconds.

        All servos restart without torque, even if the time is 0.
        """
        self.supply.brown_out(for_s)
        for servo in self.servos.values():
            servo.power_up()
        self._weigh()

    def put_arm_to_rest(self) -> None:
        """Move the unpowered arm to its parking position, as if by hand."""
        for joint, rest_deg in _rest(self.rig):
            self.servos[joint.servo].turn_by_hand(_counts(joint, rest_deg))
        self._weigh()

    @property
    def table_deg(self) -> float:
        """True table angle, deg.

        It is 0 if the seam of the marker strip faces the camera.
        """
        return self._table_start_deg + self.table.true_deg

    @property
    def joints_deg(self) -> tuple[float, ...]:
        """True joint angles from the base to the wrist roll, deg.

        The tuple is empty if the rig has no arm.
        """
        return () if (arm := self.rig.arm) is None else self._angles(arm, [self.servos[j.servo].true_counts for j in arm.joints])

    @property
    def cam_from_rig(self) -> frames.Array:
        """True transform (4, 4) from the rig frame to the camera's frame."""
        if self.rig.arm is None:
            return self.tripod_cam_from_rig
        return kinematics.cam_from_rig(self.rig.arm, self.joints_deg)

    @property
    def rig_from_canister(self) -> frames.Array:
        """True transform (4, 4) from the canister's frame to the rig frame."""
        return plan.rig_from_table(self.scene, self.table_deg) @ self.table_from_canister

    def sight(self, *, exposure: float = 1.0) -> Sight:
        """Return the present true state of the rig, from which a picture can be computed."""
        band, panel, front = self._light()
        return Sight(
            cam_from_rig=self.cam_from_rig,
            rig_from_canister=self.rig_from_canister,
            table_deg=self.table_deg,
            panel=panel,
            front=front,
            exposure=exposure,
            band=band,
            twist_deg=self.swing.twist_deg,
        )

    def _light(self) -> tuple[str, float, float]:
        """Return the name of the band that the rig is set to, and the levels of the panel and the front light.

        The band is determined from the lamps, the outputs of the board and the filter. If the band uses a lamp at a
        switched output, both levels are 1. States that match no band count as white light.
        """
        for part in self.rig.camera.bands:
            if self.outputs_on != ({part.output} - {None}) or not self._filter_is_at(part.filter_deg):
                continue
            if part.output is not None:
                return part.name, 1.0, 1.0
            lights = self.rig.lights
            panel = self._in_colour(self.panel, part.panel_rgb or lights.panel_rgb, part.panel_level)
            front = self._in_colour(self.front, part.front_rgb or lights.front_rgb, part.front_level)
            if panel is not None and front is not None:
                return part.name, panel, front
        return "", self.panel.level, self.front.level

    def _in_colour(self, lamp: Lamp, rgb: tuple[int, int, int], level: float | None) -> float | None:
        """Return the level of a lamp relative to a band's colour.

        The result is None if the lamp does not show this colour, or if it should be dark but is not.
        """
        if level == 0.0 or lamp.goal == 0.0:
            return lamp.level if level == 0.0 and lamp.goal == 0.0 else None
        share = lamp.share_of(rgb)
        return None if share is None else lamp.level * share

    def _filter_is_at(self, angle_deg: float | None) -> bool:
        """Return whether the filter wheel is at the given angle of a band."""
        wheel = None if self.rig.arm is None else self.rig.arm.filter
        if angle_deg is None or wheel is None:
            return angle_deg is None
        return abs(wheel.sign * (self.servos[wheel.servo].true_counts - wheel.zero_counts) / wheel.counts_per_deg - angle_deg) < FILTER_DEG

    def _angles(self, arm: ArmPart, counts: list[float]) -> tuple[float, ...]:
        return tuple(joint.sign * (at - joint.zero_counts) / joint.counts_per_deg for joint, at in zip(arm.joints, counts, strict=True))

    def _weigh(self) -> None:
        """Update the torques that gravity exerts on the shoulder, elbow and wrist pitch servos in the present pose."""
        if (arm := self.rig.arm) is None:
            return
        lean_rad = np.cumsum(np.deg2rad(self._angles(arm, [self.servos[j.servo].unbent_counts for j in arm.joints])[1:4]))
        links = np.array(arm.links_mm[1:])
        across = np.concatenate([[0.0], np.cumsum(links * np.sin(lean_rad))])
        most = float(_MASSES @ np.cumsum(links)) or 1.0
        for i, joint in enumerate(arm.joints[1:4]):
            torque = float(_MASSES[i:] @ (across[i + 1 :] - across[i])) / most
            self.servos[joint.servo].torque = joint.sign * torque


def _rest(rig: RigFile) -> list[tuple[Joint, float]]:
    """Return each joint with its parking angle, deg.

    The list is empty if the rig has no arm.
    """
    return [] if rig.arm is None else list(zip(rig.arm.joints, rig.arm.park_deg, strict=True))


def _counts(joint: Joint, angle_deg: float) -> float:
    return joint.zero_counts + joint.sign * joint.counts_per_deg * angle_deg


def _digest(*arrays: frames.Array) -> bytes:
    whole = np.rint(1e6 * np.concatenate([array.ravel() for array in arrays])).astype(np.int64)
    return hashlib.blake2b(whole.tobytes(), digest_size=16).digest()
