"""Rig file: description of the devices, their connections, and the position of the arm.

A rig file is a TOML file that is validated when it is read. Unknown keys are rejected.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place, from_plain

JOINT_NAMES = ("base", "shoulder", "elbow", "wrist pitch", "wrist roll")
JOINTS = len(JOINT_NAMES)
Rgb: TypeAlias = tuple[int, int, int]
LSC_BAUD = 9600


@dataclass(frozen=True, kw_only=True)
class TurntablePart:
    """Turntable and lights, driven by a Marlin 2.1 board on a serial line, or by the pins of this Raspberry Pi."""

    kind: Literal["marlin", "hat"] = "marlin"
    """Electronics that control the table and the lights. marlin: a Marlin board at ``port``. hat: a DRV8825 and
    NeoPixels on the pins of this computer (``hat``). ``port`` and ``baud`` are then not used."""
    port: str = "/dev/ttyUSB0"
    """Serial port, or any URL supported by pyserial, such as socket://localhost:4000."""
    baud: int = bounded(115200, 1200, 4_000_000)
    speed_deg_per_s: float = bounded(30.0, 0.1, 360.0)
    acceleration_deg_per_s2: float = bounded(60.0, 0.1, 10000.0)
    """Acceleration of each move, deg/s2. A Marlin board limits it to its own maximum."""
    full_step_deg: float = bounded(1.8, 0.001, 30.0)
    """Table angle of one full step of the motor, deg."""
    approach_deg: float = bounded(3.6, 0.0, 45.0)
    """Overshoot of moves against the approach direction, after which the table returns, deg. The backlash is thus
    always on the same side."""
    tolerance_deg: float = bounded(0.02, 0.01, 5.0)
    """Maximum difference between the commanded and the measured table angle, deg. A Marlin board reports angles with
    two decimals."""
    settle_s: float = bounded(0.5, 0.0, 60.0)
    """Pause between a move and the next picture, s. During this pause the water comes to rest."""
    rest: Literal["given", "measured"] = "given"
    """How the pause before each picture is determined. given: it is ``settle_s``. measured: before its first picture, a
    scan rotates the table a few times, at this acceleration and at lower accelerations, and measures how long the
    contents of the picture move. It then uses the acceleration with which a view takes the shortest time, and a pause
    of at least ``settle_s``."""


@dataclass(frozen=True, kw_only=True)
class LightsPart:
    """Backlight panel and front light: two NeoPixel strips on the same board (NEOPIXEL2_SEPARATE)."""

    panel_strip: int = bounded(0, 0, 1)
    front_strip: int = bounded(1, 0, 1)
    panel_rgb: tuple[int, int, int] = bounded((255, 255, 255), 0, 255)
    """Colour of the panel at level 1, as red, green and blue."""
    front_rgb: tuple[int, int, int] = bounded((255, 255, 255), 0, 255)
    panel_level: float = bounded(1.0, 0.0, 1.0)
    """Level of the panel during a scan, from 0 to 1."""
    front_level: float = bounded(1.0, 0.0, 1.0)
    settle_s: float = bounded(0.5, 0.0, 60.0)
    """Pause between a change of the lamps and the next picture, s."""

    def strips(self, panel: float, front: float, band: "BandPart | None") -> tuple[tuple[int, Rgb, float], ...]:
        """Return the number, colour and level of each of the two strips.

        Parameters
        ----------
        panel, front : float
            Levels of panel and front light, from 0 to 1.
        band : BandPart or None
            Band whose colours are used; None for the colours of ``[lights]``.

        Returns
        -------
        tuple of (int, (int, int, int), float)
            Number of the strip, colour at level 1, and level.
        """
        panel_rgb = (band.panel_rgb if band else None) or self.panel_rgb
        front_rgb = (band.front_rgb if band else None) or self.front_rgb
        return (self.panel_strip, panel_rgb, panel), (self.front_strip, front_rgb, front)


@dataclass(frozen=True, kw_only=True)
class HatPart:
    """Electronics of the thesis: a DRV8825 and two NeoPixel strips on the pins of a Raspberry Pi (GPIO numbers)."""

    step_pin: int = bounded(23, 0, 27)
    direction_pin: int = bounded(24, 0, 27)
    enable_pin: int = bounded(25, 0, 27)
    """GPIO pin that switches the motor on when low."""
    fault_pin: int = bounded(22, 0, 27)
    """GPIO pin that signals an overheated driver or a shorted coil when low."""
    microsteps: int = bounded(32, 1, 32)
    """Number of microsteps per full step, according to the wiring of the driver's MODE pins."""
    reverse: bool = False
    """Whether the wiring of the motor's coils reverses the table's direction of rotation."""
    panel_pin: int = bounded(18, 0, 27)
    """GPIO pin of the panel, 12 or 18 (channel 0 of rpi_ws281x)."""
    front_pin: int = bounded(13, 0, 27)
    """GPIO pin of the front light, 13 or 19 (channel 1 of rpi_ws281x)."""
    panel_pixels: int = bounded(300, 1, 5000)
    front_pixels: int = bounded(18, 1, 5000)

    @property
    def pins(self) -> list[int]:
        """Numbers of the GPIO pins in use."""
        return [value for name, value in vars(self).items() if name.endswith("_pin")]


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Servo that moves one joint of the arm."""

    servo: int = bounded(1, 0, 253)
    zero_counts: float = bounded(500.0, -2000.0, 3000.0)
    """Servo position at joint angle 0, in counts."""
    sign: Literal[1, -1] = 1
    counts_per_deg: float = bounded(1000.0 / 240.0, 0.1, 100.0)
    min_deg: float = bounded(-90.0, -360.0, 360.0)
    max_deg: float = bounded(90.0, -360.0, 360.0)


@dataclass(frozen=True, kw_only=True)
class ArmPart:
    """Robot arm with six LX servos, five of which move the camera. Omit this section if the camera is on a tripod."""

    protocol: Literal["lx", "lsc"] = "lx"
    """Protocol of the servos. lx: servo bus (115200 Bd, with checksums). lsc: controller board (9600 Bd, without
    checksums)."""
    port: str = "/dev/ttyUSB1"
    baud: int = bounded(115200, 1200, 4_000_000)
    echo: Literal["auto", "yes", "no"] = "auto"
    """Whether the half-duplex adapter echoes transmitted bytes (only for protocol lx)."""
    joints: tuple[Joint, ...] = (
        Joint(servo=6, min_deg=-90.0, max_deg=90.0),
        Joint(servo=5, min_deg=-86.0, max_deg=91.0),
        Joint(servo=4, min_deg=-88.0, max_deg=88.0),
        Joint(servo=3, min_deg=-112.0, max_deg=112.0),
        Joint(servo=2, min_deg=-112.0, max_deg=112.0),
    )
    """Joints in this order: base, shoulder, elbow, wrist pitch, wrist roll."""
    links_mm: tuple[float, float, float, float] = bounded((61.0, 101.6, 96.4, 95.0), 0.0, 2000.0)
    """Lengths of the links, mm: from the base plate to the shoulder axis, from there to the elbow axis, from there to
    the wrist pitch axis, and from there to the centre of the camera."""
    position_mm: tuple[float, float, float] = bounded((650.0, 0.0, -50.0), -5000.0, 5000.0)
    """Centre of the base plate's underside in the rig frame, mm. The default is 145 mm above the floor, so that the arm
    can reach the rings for root and shoot."""
    rotation_deg: tuple[float, float, float] = bounded((0.0, 0.0, 180.0), -360.0, 360.0)
    """Rotation vector from the arm frame to the rig frame, deg. In the arm frame, +z is along the base's axis, and the
    arm leans toward +x at positive shoulder angles."""
    max_speed_deg_per_s: float = bounded(60.0, 1.0, 270.0)
    tolerance_deg: float = bounded(3.0, 0.1, 30.0)
    """Maximum difference between the commanded and the measured joint angle after a move, deg. It includes sag and the
    dead band of the servo."""
    settle_s: float = bounded(1.0, 0.0, 60.0)
    park_deg: tuple[float, float, float, float, float] = bounded((0.0, -60.0, 80.0, 70.0, 0.0), -360.0, 360.0)
    """Joint angles of the parking position, in which the arm's torque is switched off, deg. The arm returns to it at
    the end of a scan, and the paths of a scan are checked beforehand from and to this position."""
    filter: Joint | None = None
    """Servo of the end effector that rotates a filter wheel in front of the lens. It is None if there is no filter
    wheel."""
    min_volt: float = bounded(6.5, 4.5, 12.0)
    max_volt: float = bounded(8.4, 4.5, 12.0)
    max_celsius: float = bounded(65.0, 20.0, 85.0)
    correct: bool = True
    """Whether to correct the camera's position for each ring using the markers."""


@dataclass(frozen=True, kw_only=True)
class BandPart:
    """Lamp and filter settings for one band of the scene's camera."""

    name: str = ""
    """Name of the band in the scene."""
    panel_rgb: tuple[int, int, int] | None = field(default=None, metadata={"limits": (0, 255)})
    """Colour of the panel at level 1. If it is None, the colour in ``[lights]`` is used."""
    front_rgb: tuple[int, int, int] | None = field(default=None, metadata={"limits": (0, 255)})
    """Colour of the front light at level 1. If it is None, the colour in ``[lights]`` is used."""
    panel_level: float | None = field(default=None, metadata={"limits": (0.0, 1.0)})
    """Level of the panel. If it is None, the level in ``[lights]`` is used."""
    front_level: float | None = field(default=None, metadata={"limits": (0.0, 1.0)})
    """Level of the front light. If it is None, the level in ``[lights]`` is used."""
    output: int | None = field(default=None, metadata={"limits": (0, 27)})
    """Output that switches an additional lamp, such as near-infrared LEDs. The lamp is on only while pictures of this
    band are taken. The number is that of a fan output of the Marlin board (M106), or of a GPIO pin of the Raspberry Pi
    (hat)."""
    filter_deg: float | None = field(default=None, metadata={"limits": (-360.0, 360.0)})
    """Angle, deg, to which the servo of the end effector (``arm.filter``) rotates the filter wheel for this band."""


@dataclass(frozen=True, kw_only=True)
class CameraPart:
    """Camera of this Raspberry Pi (picamera2), on USB (v4l2, gphoto2), or of another computer (http)."""

    kind: Literal["picamera2", "v4l2", "gphoto2", "http"] = "picamera2"
    address: str = "0"
    """Camera address. picamera2, v4l2 and gphoto2: number of the camera (for v4l2 also its device file, for gphoto2
    also its port, such as usb:001,004). http: URL such as http://raspberrypi:8471."""
    exposure_s: float = bounded(0.01, 1e-5, 100.0)
    gain: float = bounded(1.0, 0.0, 100.0)
    """Gain of the sensor. For gphoto2 it is the ISO divided by 100."""
    colour_gains: tuple[float, float] = bounded((2.0, 2.0), 0.1, 32.0)
    """Gains of red and blue for a fixed white balance (picamera2, and raw files of gphoto2)."""
    white_balance_kelvin: int = bounded(5000, 1000, 20000)
    """Colour temperature for a fixed white balance, K (v4l2)."""
    f_number: float | None = field(default=None, metadata={"limits": (0.5, 128.0)})
    """Aperture of a lens that the camera controls (gphoto2). If it is None, the present aperture is kept."""
    trigger: Literal["usb", "board"] = "usb"
    """Device that releases the shutter (gphoto2). usb: the computer. board: the electronics of the table, which are
    connected to the camera's shutter input; the file is still read over USB."""
    trigger_pin: int | None = field(default=None, metadata={"limits": (0, 255)})
    """Pin that releases the shutter: of the Marlin board (M42), or GPIO pin of the Raspberry Pi (hat). If it is None, a
    Marlin board releases the shutter by M240."""
    bands: tuple[BandPart, ...] = ()
    """Lamp and filter settings for each entry of ``[[camera.bands]]`` in the scene."""


@dataclass(frozen=True, kw_only=True)
class Bar:
    """Box that the arm must avoid, such as a part of the frame or a lamp, in the rig frame."""

    low_mm: tuple[float, float, float] = bounded((0.0, 0.0, 0.0), -5000.0, 5000.0)
    high_mm: tuple[float, float, float] = bounded((0.0, 0.0, 0.0), -5000.0, 5000.0)


@dataclass(frozen=True, kw_only=True)
class Clearance:
    """Dimensions used in the collision checks of the arm, and additional obstacles.

    The canister, the net pot and the tank of the scene are always obstacles.
    """

    margin_mm: float = bounded(15.0, 0.0, 500.0)
    """Minimum distance between obstacles and the arm with its camera, mm. It allows for sag and backlash."""
    arm_radius_mm: float = bounded(32.0, 1.0, 300.0)
    """Half the width of the arm's links, mm."""
    camera_radius_mm: float = bounded(35.0, 1.0, 300.0)
    """Radius of a sphere around the camera's centre that encloses camera and lens, mm."""
    table_radius_mm: float = bounded(110.0, 1.0, 2000.0)
    floor_z_mm: float = bounded(-195.0, -5000.0, 0.0)
    """Height (z) of the surface on which the arm's base and the turntable stand, mm."""
    bars: tuple[Bar, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Named camera pose in the rig frame, for ``look NAME`` in ``rhizotwin rig jog``."""

    name: str = ""
    position_mm: tuple[float, float, float] = bounded((400.0, 0.0, -42.0), -5000.0, 5000.0)
    """Centre of the camera, mm."""
    direction: tuple[float, float, float] = bounded((-1.0, 0.0, 0.0), -1e6, 1e6)
    """Direction of the optical axis, of any length."""


@dataclass(frozen=True, kw_only=True)
class RigFile:
    """Complete description of a rig and its devices."""

    name: str = "rig"
    description: str = ""
    turntable: TurntablePart = TurntablePart()
    lights: LightsPart = LightsPart()
    hat: HatPart = HatPart()
    arm: ArmPart | None = None
    camera: CameraPart = CameraPart()
    clearance: Clearance = Clearance()
    poses: tuple[Pose, ...] = ()


def load_rig(path: Path | str) -> RigFile:
    """Load a rig file and check its values.

    Raises
    ------
    UserError
        If the file is missing, or has an unknown key, a wrong type, a value beyond its limits (the message states the
        line), or inconsistent values.
    """
    table, text = read_toml(Path(path))
    place = Place(str(path), text)
    rig = from_plain(RigFile, table, place)
    check_rig(rig, place)
    return rig


def check_rig(rig: RigFile, place: Place) -> None:
    """Raise an error if the values of a rig file are inconsistent with each other."""
    if rig.lights.panel_strip == rig.lights.front_strip:
        raise place.at("lights", "front_strip").error(
            "must differ from panel_strip, because each lamp requires a separate strip", rig.lights.front_strip
        )
    _check_hat(rig.hat, place.at("hat"))
    _check_bands(rig, place.at("camera"))
    _check_trigger(rig, place.at("camera"))
    for i, bar in enumerate(rig.clearance.bars):
        if any(low >= high for low, high in zip(bar.low_mm, bar.high_mm, strict=True)):
            raise place.at("clearance", "bars", i, "high_mm").error("must be above low_mm on every axis", list(bar.high_mm))
    names = [pose.name for pose in rig.poses]
    for i, name in enumerate(names):
        if not name or not name.isidentifier() or name in names[:i]:
            raise place.at("poses", i, "name").error("must be a unique name of letters and digits that does not begin with a digit", name)
    if rig.arm is not None:
        _check_arm(rig.arm, place.at("arm"))
        if rig.turntable.kind == "marlin" and rig.arm.port == rig.turntable.port:
            raise place.at("arm", "port").error("must differ from the port of [turntable], because each device has its own", rig.arm.port)


def _check_hat(hat: HatPart, place: Place) -> None:
    names = ("step_pin", "direction_pin", "enable_pin", "fault_pin", "panel_pin", "front_pin")
    pins = [getattr(hat, name) for name in names]
    for i, (name, pin) in enumerate(zip(names, pins, strict=True)):
        if pin in pins[:i]:
            raise place.at(name).error(f"must differ from {names[pins.index(pin)]}", pin)
    for name, allowed in (("panel_pin", (12, 18)), ("front_pin", (13, 19))):
        if getattr(hat, name) not in allowed:
            raise place.at(name).error(
                f"must be {allowed[0]} or {allowed[1]}, because only these pins support NeoPixels", getattr(hat, name)
            )
    if hat.microsteps & (hat.microsteps - 1):
        raise place.at("microsteps").error("must be 1, 2, 4, 8, 16 or 32", hat.microsteps)


def _check_trigger(rig: RigFile, place: Place) -> None:
    camera = rig.camera
    if camera.trigger == "board" and camera.kind != "gphoto2":
        raise place.at("trigger").error(f"is possible only for kind gphoto2, not {camera.kind}", camera.trigger)
    if camera.trigger == "board" and rig.turntable.kind == "hat" and camera.trigger_pin not in set(range(28)) - set(rig.hat.pins):
        given = () if camera.trigger_pin is None else (camera.trigger_pin,)
        raise place.at("trigger_pin").error("must be a GPIO pin, from 0 to 27, that is not used in [hat]", *given)


def _check_bands(rig: RigFile, place: Place) -> None:
    wheel = None if rig.arm is None else rig.arm.filter
    taken = [] if rig.turntable.kind != "hat" else [*rig.hat.pins, rig.camera.trigger_pin]
    names = [band.name for band in rig.camera.bands]
    for i, band in enumerate(rig.camera.bands):
        here = place.at("bands", i)
        if not band.name or band.name in names[:i]:
            raise here.at("name").error("must be the name of a band in the scene, and unique", band.name)
        if band.output is not None and band.output in taken:
            raise here.at("output").error("must not be a pin that is used in [hat]", band.output)
        if band.filter_deg is not None and wheel is None:
            raise here.at("filter_deg").error(
                "requires the section [arm.filter], which describes the servo of the filter wheel", band.filter_deg
            )
        if band.filter_deg is not None and wheel is not None and not wheel.min_deg <= band.filter_deg <= wheel.max_deg:
            must = f"must be between min_deg and max_deg of arm.filter, {wheel.min_deg:g} and {wheel.max_deg:g} deg"
            raise here.at("filter_deg").error(must, band.filter_deg)


def _check_arm(arm: ArmPart, place: Place) -> None:
    if len(arm.joints) != JOINTS:
        raise place.at("joints").error(f"must have {JOINTS} entries: {', '.join(JOINT_NAMES)}", len(arm.joints))
    if len({joint.servo for joint in arm.joints}) != JOINTS:
        raise place.at("joints").error("must have different servo numbers", [joint.servo for joint in arm.joints])
    if arm.filter is not None and arm.filter.servo in {joint.servo for joint in arm.joints}:
        raise place.at("filter", "servo").error("must differ from the joints' servos", arm.filter.servo)
    for i, (joint, rest) in enumerate(zip(arm.joints, arm.park_deg, strict=True)):
        if joint.min_deg >= joint.max_deg:
            raise place.at("joints", i, "max_deg").error(f"must be above min_deg {joint.min_deg:g}", joint.max_deg)
        if not joint.min_deg <= rest <= joint.max_deg:
            raise place.at("park_deg").error(
                f"element {i + 1} must be between the joint's min_deg {joint.min_deg:g} and max_deg {joint.max_deg:g}", rest
            )
    if arm.protocol == "lsc" and arm.baud != LSC_BAUD:
        raise place.at("baud").error(f"must be {LSC_BAUD}, the only rate that the controller board (protocol lsc) supports", arm.baud)
    if arm.min_volt >= arm.max_volt:
        raise place.at("max_volt").error(f"must be above min_volt {arm.min_volt:g}", arm.max_volt)
