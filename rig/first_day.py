"""First check of a real rig.

The user is guided through tests that an emulated rig cannot replace. The results are written to a report.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from rhizotwin.rig.jog import Jog, parse_number
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.homing import Ask, facing_angle, wrap_angle
from rhizotwin.rig.scanning.markers import Sighting, read_strip, unread_reason
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.atomic import write_bytes, write_json, write_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey, encode_png
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import to_plain

TURN_DEG, JOINT_DEG = 9.0, 5.0
TURN_TOLERANCE_DEG = 1.0
"""Maximum difference between the commanded and the measured table angle, deg. The angle measured in a single picture
has an error of a few tenths of a degree. A wrong direction causes an error of 18 deg, and a wrong gear ratio an error
of several degrees."""
BLOCKS_XY = (16, 12)
LEAST_CONTRAST = 0.3
"""Minimum contrast of a picture that shows the net pot in front of the panel. The net pot absorbs nearly all light,
whereas the contrast of the panel alone is lower (see `LEAST_EVEN`)."""
LEAST_EVEN = 0.6
"""Minimum ratio of the brightness of the panel's darkest part to that of its brightest part. The reconstruction
corrects differences in brightness, but darker parts are noisier."""
CALIPER_MM = 0.3
"""Tolerance of dimensions measured with callipers, mm. For the net pot, with a diameter of 159 mm, an error of 0.3 mm
changes every length by 0.2 % and the volume by 0.6 %."""
JOINTS = (
    "the base turn counter-clockwise, seen from above",
    *[f"the {name} lean toward the canister" for name in ("shoulder", "elbow", "wrist")],
    "the camera roll, and nothing else move",
)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one step of the guided check."""

    step: str
    verdict: str
    """Verdict of the step: ``ok``, ``wrong`` or ``skipped``."""
    text: str
    measured: dict[str, float] = field(default_factory=dict)


class FirstDay:
    """First check of a rig, in which the user is guided through several steps."""

    def __init__(self, devices: Devices, scene: Scene, *, ask: Ask, say: Say, folder: Path) -> None:
        self._scene, self._ask, self._say, self._folder = scene, ask, say, folder
        self._devices = devices
        self._jog = Jog(devices, scene, say=say)
        self._before_canister = devices.arm is None
        """Whether the camera is in front of the canister, so that it shows the strip and the water. A camera on a
        tripod is assumed to be there."""
        self.findings: list[Finding] = []

    def walk(self, *, wrong_devices: int) -> list[Finding]:
        """Run all steps and return their results.

        The results are written and the rig is left in a safe state, even if an error occurs.

        Parameters
        ----------
        wrong_devices : int
            Number of problems found by `rig.bench.check`.
        """
        self._record_finding(
            "devices",
            wrong_devices == 0,
            f"problems found: {wrong_devices}; see the lines above" if wrong_devices else "all devices reply",
        )
        steps: list[tuple[str, Callable[[], None]]] = [
            ("lamps", self._lamps),
            *[(f"joint {k + 1}", self._joint_step(k)) for k in range(len(JOINTS))],
            ("arm", self._arm),
            ("focus", self._focus),
            ("strip", self._strip),
            ("panel", self._panel),
            ("table", self._table),
            ("calipers", self._calipers),
        ]
        try:
            for name, step in steps:
                self._say(f"--- {name}")
                try:
                    step()
                except UserError as error:
                    self._note(Finding(step=name, verdict="wrong", text=str(error)))
            remarks = self._ask("Anything else that was unexpected? ")
            if remarks.strip():
                self._note(Finding(step="remarks", verdict="skipped", text=remarks.strip()))
        finally:
            self._jog.leave()
            self._write()
        return self.findings

    def _lamps(self) -> None:
        self._jog.do(["lights", "1", "1"])
        self._record_finding(
            "lamps",
            self._yes("Are the whole panel and the front lamp lit, evenly to the eye and without flicker?"),
            "judged by eye",
        )

    def _arm(self) -> None:
        """Move the camera in front of the canister. The step is skipped unless every joint has passed its test."""
        if self._devices.arm is None:
            self._note(Finding(step="arm", verdict="skipped", text="this rig has no arm"))
            return
        if any(one.verdict != "ok" for one in self.findings if one.step.startswith("joint")):
            self._note(
                Finding(
                    step="arm",
                    verdict="skipped",
                    text="the arm is not moved before all joints are ok; correct them first",
                )
            )
            return
        ring = self._scene.plan.rings[0]
        where = f"{ring.distance_mm:g} mm from the axis, {ring.height_mm:g} mm above the rim"
        if not self._yes(f"Keep a hand on the switch. May the arm move the camera in front of the canister ({where})?"):
            self._note(Finding(step="arm", verdict="skipped", text="the user did not permit the move"))
            return
        self._jog.do(["go", f"{ring.distance_mm:g}", f"{ring.height_mm:g}", f"{ring.tilt_deg:g}"])
        self._before_canister = self._yes("Does the camera face the canister, with strip and water in the picture?")
        self._record_finding("arm", self._before_canister, f"judged by eye, with the camera {where}")

    def _out_of_place(self, step: str) -> bool:
        """Return whether the camera is not in front of the canister. In this case, the step is recorded as skipped."""
        if not self._before_canister:
            self._note(Finding(step=step, verdict="skipped", text="the camera is not in front of the canister"))
        return not self._before_canister

    def _focus(self) -> None:
        if self._out_of_place("focus"):
            return
        image = self._jog.shot()
        write_bytes(self._folder / "focus.png", encode_png(image))
        if contrast(image) < LEAST_CONTRAST:
            self._record_finding(
                "focus",
                False,
                "no dark object is visible in front of the panel; bring net pot, strip and canister into the picture (focus.png)",
            )
            return
        width_px, cell_px = edge_width_px(image), self._cell_px()
        sharp = width_px < 0.5 * cell_px
        text = f"the sharpest edges are {width_px:.1f} px wide, and a cell of a marker is {cell_px:.1f} px wide"
        cure = "; turn the focus until edges are less than half a cell wide"
        self._record_finding("focus", sharp, text if sharp else text + cure, edge_px=width_px, cell_px=cell_px)

    def _strip(self) -> None:
        if self._out_of_place("strip"):
            return
        image = self._jog.shot()
        seen = read_strip(image, self._scene)
        if seen is not None:
            self._record_finding(
                "strip",
                True,
                f"{seen.markers} markers were read with a reprojection error of {seen.reprojection_px:.2f} px",
                reprojection_px=seen.reprojection_px,
            )
        elif read_strip(np.ascontiguousarray(image[:, ::-1]), self._scene) is not None:
            self._record_finding(
                "strip",
                False,
                "the picture is mirrored: switch off the camera's flip option, or reprint the strip if it was printed mirrored",
            )
        else:
            self._record_finding("strip", False, unread_reason(image, self._scene))

    def _panel(self) -> None:
        if self._out_of_place("panel"):
            return
        self._jog.do(["lights", "1", "0"])
        image = self._jog.shot()
        write_bytes(self._folder / "panel.png", encode_png(image))
        even, full = panel_evenness(image), preflight.measure_exposure(image).saturated
        good = even >= LEAST_EVEN and full <= preflight.MOST_SATURATED
        text = (
            f"the darker parts have {100.0 * even:.0f} % of the brightness of the brighter parts; {100.0 * full:.1f} % of the picture is "
            "at full scale"
        )
        self._record_finding("panel", good, text, evenness=even, saturated=full)
        self._jog.do(["lights", "1", "1"])

    def _table(self) -> None:
        sense = "counter-clockwise" if self._scene.turntable.direction == 1 else "clockwise"
        before = self._sighting()
        self._jog.do(["home"] if before is not None else ["home", "0"])
        self._jog.do(["table", f"+{TURN_DEG:g}"])
        seen_right = self._yes(f"Did the table turn {sense} by about {TURN_DEG:g} degrees, seen from above?")
        after = self._sighting()
        self._jog.do(["table", f"-{TURN_DEG:g}"])
        back = self._sighting()
        if before is None or after is None or back is None:
            self._record_finding("table", seen_right, "judged by eye; the markers could not be read")
            return
        turn, miss = (wrap_angle(facing_angle(b, self._scene) - facing_angle(a, self._scene)) for a, b in ((before, after), (before, back)))
        measured = abs(turn - TURN_DEG) <= TURN_TOLERANCE_DEG
        text = f"the table was commanded to turn by {TURN_DEG:g} deg; the markers turned by {turn:.2f} deg and returned to {miss:+.2f} deg"
        if abs(turn + TURN_DEG) <= TURN_TOLERANCE_DEG:
            text += (
                ". The direction is wrong: swap the wires of a motor coil, set INVERT_X_DIR or hat.reverse, or turntable.direction = -1 "
                "in the scene"
            )
        elif not measured:
            text += "; correct the steps per degree"
        elif not seen_right:
            text += f". The markers confirm the turn, but it was not observed as {sense}; check whether the strip is upside down"
        self._record_finding("table", measured and seen_right, text, turned_deg=turn, back_deg=miss)

    def _joint_step(self, k: int) -> Callable[[], None]:
        def step() -> None:
            arm = self._devices.arm
            name = f"joint {k + 1}"
            if arm is None:
                self._note(Finding(step=name, verdict="skipped", text="this rig has no arm"))
                return
            if not self._yes(f"Keep a hand on the switch of the arm's supply. May joint {k + 1} move by {JOINT_DEG:g} degrees?"):
                self._note(Finding(step=name, verdict="skipped", text="the user did not permit the move"))
                return
            self._jog.do(["joint", str(k + 1), "+0"])  # connects
            before = arm.read_joints()[k]
            self._jog.do(["joint", str(k + 1), f"+{JOINT_DEG:g}"])
            moved_deg = arm.read_joints()[k] - before
            right = self._yes(f"Did {JOINTS[k]}?")
            self._jog.do(["joint", str(k + 1), f"-{JOINT_DEG:g}"])
            text = f"the joint was commanded to move by {JOINT_DEG:g} deg, and its servo reports {moved_deg:+.1f} deg"
            self._record_finding(
                name, right, text + ("" if right else f"; reverse the sign of arm.joints {k + 1} in the rig file"), moved_deg=moved_deg
            )

        return step

    def _calipers(self) -> None:
        pot, strip = self._scene.net_pot, self._scene.strip
        asked = [
            ("across the net pot, over the strip's paper", 2.0 * pot.outer_radius_mm, "net_pot.outer_radius_mm, half of what you measure")
        ]
        asked.append(
            ("across the canister", 2.0 * self._scene.canister.outer_radius_mm, "canister.outer_radius_mm, half of what you measure")
        )
        if strip.rows:
            asked.append(
                (
                    "from edge to edge over ten markers in a row",
                    9.0 * 2.0 * np.pi * pot.outer_radius_mm / strip.columns + strip.marker_mm,
                    "",
                )
            )
        for what, given_mm, key in asked:
            answer = self._ask(f"Measure with callipers or tape: how many mm is it {what}? (leave empty to skip) ").strip()
            if not answer:
                self._note(Finding(step="calipers", verdict="skipped", text=what))
                continue
            try:
                measured_mm = parse_number(answer)
            except ValueError:
                self._note(Finding(step="calipers", verdict="skipped", text=f"{what}: {answer!r} is not a number"))
                continue
            near = abs(measured_mm - given_mm) <= CALIPER_MM
            text = f"{what}: measured {measured_mm:.2f} mm, but {given_mm:.2f} mm in the scene"
            cure = (
                f"; correct {key}"
                if key
                else "; the print is not to scale: measure its ruler and use `rhizotwin markers --printed-ruler-mm`"
            )
            self._record_finding("calipers", near, text if near else text + cure, measured_mm=measured_mm, given_mm=given_mm)

    def _sighting(self) -> Sighting | None:
        return read_strip(self._jog.shot(), self._scene)

    def _cell_px(self) -> float:
        """Return the expected side length of a cell of a marker in the pictures of the first ring, px.

        A marker of AprilTag 36h11 consists of 6x6 cells and a black border of one cell, thus of 8x8 cells.
        """
        from rhizotwin.scenes.markers import get_dictionary

        lens, ring, strip = self._scene.camera.as_pinhole(), self._scene.plan.rings[0], self._scene.strip
        cells = int(get_dictionary(strip.dictionary).markerSize) + 2
        distance_mm = ring.distance_mm - self._scene.net_pot.outer_radius_mm
        return lens.focal_px[0] * strip.marker_mm / cells / distance_mm

    def _yes(self, question: str) -> bool:
        while True:
            answer = self._ask(f"{question} [yes/no] ").strip().lower()
            if answer in ("y", "yes", "n", "no"):
                return answer.startswith("y")
            self._say("please answer yes or no")

    def _record_finding(self, step: str, good: bool, text: str, **measured: float) -> None:
        self._note(Finding(step=step, verdict="ok" if good else "wrong", text=text, measured=measured))

    def _note(self, finding: Finding) -> None:
        self.findings.append(finding)
        self._say(f"{finding.step:<10} {finding.verdict:<7} {finding.text}")

    def _write(self) -> None:
        rig = to_plain(self._devices.rig)
        write_json(
            self._folder / "first_day.json",
            {"findings": [asdict(one) for one in self.findings], "rig": rig, "scene": to_plain(self._scene), "versions": versions()},
        )
        write_text(self._folder / "first_day.md", report(self.findings, self._devices.rig.name))


def report(findings: Sequence[Finding], name: str) -> str:
    """Format the results as a Markdown report."""
    rows = [f"| {one.step} | {one.verdict} | {one.text.replace('|', '/')} |" for one in findings]
    wrong = sum(one.verdict == "wrong" for one in findings)
    head = [
        f"# First check of {name}",
        "",
        f"{len(findings)} steps, {wrong} with a problem.",
        "",
        "| step | verdict | result |",
        "|---|---|---|",
    ]
    return "\n".join([*head, *rows, ""])


def edge_width_px(image: Grey) -> float:
    """Return the width of the sharpest vertical edges, px.

    The width is the difference between bright and dark pixel values, divided by the steepest slope. The 99.9th
    percentile of the slopes is used, because single noisy pixels can have steeper slopes.
    """
    numbers = image.astype(np.float64)
    slope = np.abs(numbers[:, 2:] - numbers[:, :-2]) / 2.0
    low, high = np.percentile(numbers, (2.0, 98.0))
    return float((high - low) / max(float(np.percentile(slope, 99.9)), 1e-9))


def contrast(image: Grey) -> float:
    """Return the contrast of a picture.

    It is 1 minus the ratio of the 2nd to the 98th percentile of the pixel values.
    """
    dark, bright = np.percentile(image, (2.0, 98.0))
    return float(1.0 - dark / max(bright, 1.0))


def panel_evenness(image: Grey) -> float:
    """Return the ratio of the brightness of the panel's darker parts to that of its brighter parts.

    The picture is divided into blocks, of which those that mostly show the panel are used. The darker and brighter
    parts are the 5th and the 95th percentile of the blocks' medians.
    """
    height, width = image.shape
    rows, columns = np.array_split(np.arange(height), BLOCKS_XY[1]), np.array_split(np.arange(width), BLOCKS_XY[0])
    blocks = np.array([[np.median(image[np.ix_(row, column)]) for column in columns] for row in rows])
    panel = blocks[blocks > 0.5 * np.percentile(blocks, 95.0)]
    dark, bright = np.percentile(panel, (5.0, 95.0))
    return float(dark / bright)
