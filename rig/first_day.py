"""Interactive checklist for the first day of a real rig.

It checks properties that cannot be emulated, and writes a report.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from rhizotwin.rig.jog import Jog, finite
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.homing import Ask, facing_angle, wrapped
from rhizotwin.rig.scanning.markers import Sighting, read_strip, why_unread
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.atomic import write_bytes, write_json, write_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey, encode_png
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import to_plain

TURN_DEG, JOINT_DEG = 9.0, 5.0
TURN_TOLERANCE_DEG = 1.0
"""Tolerance of the rotation. The angle from a single picture is accurate to some tenths of a degree; a wrong
direction gives an error of 18 degrees, a wrong gear ratio several degrees."""
BLOCKS_XY = (16, 12)
LEAST_CONTRAST = 0.3
"""Minimum contrast of a picture with an object in front of the panel: the pot alone absorbs nearly all light; an
empty panel varies less (`LEAST_EVEN` refers to its corners)."""
LEAST_EVEN = 0.6
"""Minimum brightness ratio of the darkest to the brightest part of the panel. The reconstruction corrects it, with a
loss of photons."""
CALIPER_MM = 0.3
"""Tolerance of the calipers: 0.3 mm across the pot of 159 mm is 0.2 % of every length and 0.6 % of the volume."""
JOINTS = (
    "the base rotate counter-clockwise, as seen from above",
    *[f"the {name} tilt toward the canister" for name in ("shoulder", "elbow", "wrist")],
    "the camera roll, without any other movement",
)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one step of the checklist."""

    step: str
    verdict: str
    """``ok``, ``wrong`` or ``skipped``."""
    text: str
    measured: dict[str, float] = field(default_factory=dict)


class FirstDay:
    """Interactive checklist of a rig."""

    def __init__(self, devices: Devices, scene: Scene, *, ask: Ask, say: Say, folder: Path) -> None:
        self._scene, self._ask, self._say, self._folder = scene, ask, say, folder
        self._devices = devices
        self._jog = Jog(devices, scene, say=say)
        self._before_canister = devices.arm is None
        """Whether the camera faces strip and water, as it does on a tripod."""
        self.findings: list[Finding] = []

    def walk(self, *, wrong_devices: int) -> list[Finding]:
        """Run the checklist; in any case the rig is left safe, and the findings are written.

        Parameters
        ----------
        wrong_devices : int
            Number of failed checks of `rig.bench.check`.
        """
        self._found("devices", wrong_devices == 0, f"{wrong_devices} failed; see the messages above" if wrong_devices else "all answer")
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
            remarks = self._ask("Any other observations? ")
            if remarks.strip():
                self._note(Finding(step="remarks", verdict="skipped", text=remarks.strip()))
        finally:
            self._jog.leave()
            self._write()
        return self.findings

    def _lamps(self) -> None:
        self._jog.do(["lights", "1", "1"])
        self._found(
            "lamps",
            self._yes("Are the complete panel and the front lamp on, uniform to the eye and without flicker?"),
            "as observed",
        )

    def _arm(self) -> None:
        """Move the camera in front of the canister, after all joints were found to move in the correct direction."""
        if self._devices.arm is None:
            self._note(Finding(step="arm", verdict="skipped", text="this rig has no arm"))
            return
        if any(one.verdict != "ok" for one in self.findings if one.step.startswith("joint")):
            self._note(
                Finding(step="arm", verdict="skipped", text="skipped until all joints are ok; correct them and run the checklist again")
            )
            return
        ring = self._scene.plan.rings[0]
        where = f"{ring.distance_mm:g} mm from the axis, {ring.height_mm:g} mm above the rim"
        if not self._yes(f"Keep a hand on the power switch of the arm. Move the camera in front of the canister ({where})?"):
            self._note(Finding(step="arm", verdict="skipped", text="not moved"))
            return
        self._jog.do(["go", f"{ring.distance_mm:g}", f"{ring.height_mm:g}", f"{ring.tilt_deg:g}"])
        self._before_canister = self._yes("Does the camera face the canister, with strip and water in the picture?")
        self._found("arm", self._before_canister, f"as observed: {where}")

    def _out_of_place(self, step: str) -> bool:
        """Skip a step whose picture would not show the canister."""
        if not self._before_canister:
            self._note(Finding(step=step, verdict="skipped", text="the camera is not in front of the canister"))
        return not self._before_canister

    def _focus(self) -> None:
        if self._out_of_place("focus"):
            return
        image = self._jog.shot()
        write_bytes(self._folder / "focus.png", encode_png(image))
        if contrast(image) < LEAST_CONTRAST:
            self._found(
                "focus", False, "no dark object is in front of the panel: bring pot, strip and canister into the picture (focus.png)"
            )
            return
        width_px, cell_px = edge_width_px(image), self._cell_px()
        sharp = width_px < 0.5 * cell_px
        text = f"the sharpest edges are {width_px:.1f} px wide, a marker cell is {cell_px:.1f} px wide"
        cure = "; adjust the focus until edges are narrower than half a cell"
        self._found("focus", sharp, text if sharp else text + cure, edge_px=width_px, cell_px=cell_px)

    def _strip(self) -> None:
        if self._out_of_place("strip"):
            return
        image = self._jog.shot()
        seen = read_strip(image, self._scene)
        if seen is not None:
            self._found(
                "strip",
                True,
                f"{seen.markers} markers, reprojection error {seen.reprojection_px:.2f} px",
                reprojection_px=seen.reprojection_px,
            )
        elif read_strip(np.ascontiguousarray(image[:, ::-1]), self._scene) is not None:
            self._found(
                "strip",
                False,
                "the picture is mirrored: disable the flip of the camera, or print the strip again if it was printed mirrored",
            )
        else:
            self._found("strip", False, why_unread(image, self._scene))

    def _panel(self) -> None:
        if self._out_of_place("panel"):
            return
        self._jog.do(["lights", "1", "0"])
        image = self._jog.shot()
        write_bytes(self._folder / "panel.png", encode_png(image))
        even, full = panel_evenness(image), preflight.exposure_of(image).saturated
        good = even >= LEAST_EVEN and full <= preflight.MOST_SATURATED
        text = (
            f"darker parts have {100.0 * even:.0f} % of the brightness of brighter "
            f"ones, {100.0 * full:.1f} % of the pixels are at full scale"
        )
        self._found("panel", good, text, evenness=even, saturated=full)
        self._jog.do(["lights", "1", "1"])

    def _table(self) -> None:
        sense = "counter-clockwise" if self._scene.turntable.direction == 1 else "clockwise"
        before = self._sighting()
        self._jog.do(["home"] if before is not None else ["home", "0"])
        self._jog.do(["table", f"+{TURN_DEG:g}"])
        seen_right = self._yes(f"Did the turntable rotate {sense} by about {TURN_DEG:g} degrees, as seen from above?")
        after = self._sighting()
        self._jog.do(["table", f"-{TURN_DEG:g}"])
        back = self._sighting()
        if before is None or after is None or back is None:
            self._found("table", seen_right, "as observed; the markers could not be detected")
            return
        turn, miss = (wrapped(facing_angle(b, self._scene) - facing_angle(a, self._scene)) for a, b in ((before, after), (before, back)))
        measured = abs(turn - TURN_DEG) <= TURN_TOLERANCE_DEG
        text = f"commanded {TURN_DEG:g} deg, measured {turn:.2f} deg by the markers, returned to {miss:+.2f} deg"
        if abs(turn + TURN_DEG) <= TURN_TOLERANCE_DEG:
            text += ": wrong direction; swap a coil of the motor, set INVERT_X_DIR or hat.reverse, or turntable.direction = -1 in the scene"
        elif not measured:
            text += ": correct the steps per degree"
        elif not seen_right:
            text += f"; correct by the markers, but no rotation {sense} was observed: is the strip upside down?"
        self._found("table", measured and seen_right, text, turned_deg=turn, back_deg=miss)

    def _joint_step(self, k: int) -> Callable[[], None]:
        def step() -> None:
            arm = self._devices.arm
            name = f"joint {k + 1}"
            if arm is None:
                self._note(Finding(step=name, verdict="skipped", text="this rig has no arm"))
                return
            if not self._yes(f"Keep a hand on the power switch of the arm. Move joint {k + 1} by {JOINT_DEG:g} degrees?"):
                self._note(Finding(step=name, verdict="skipped", text="not moved"))
                return
            self._jog.do(["joint", str(k + 1), "+0"])  # connects
            before = arm.read_joints()[k]
            self._jog.do(["joint", str(k + 1), f"+{JOINT_DEG:g}"])
            moved_deg = arm.read_joints()[k] - before
            right = self._yes(f"Did {JOINTS[k]}?")
            self._jog.do(["joint", str(k + 1), f"-{JOINT_DEG:g}"])
            text = f"commanded {JOINT_DEG:g} deg, the servo reports {moved_deg:+.1f} deg"
            self._found(name, right, text + ("" if right else f"; invert the sign of arm.joints {k + 1}"), moved_deg=moved_deg)

        return step

    def _calipers(self) -> None:
        pot, strip = self._scene.net_pot, self._scene.strip
        asked = [
            (
                "diameter of the net pot over the paper of the strip",
                2.0 * pot.outer_radius_mm,
                "net_pot.outer_radius_mm, half of the measured diameter",
            )
        ]
        asked.append(
            (
                "diameter of the canister",
                2.0 * self._scene.canister.outer_radius_mm,
                "canister.outer_radius_mm, half of the measured diameter",
            )
        )
        if strip.rows:
            asked.append(
                (
                    "width of ten markers in a row, from edge to edge",
                    9.0 * 2.0 * np.pi * pot.outer_radius_mm / strip.columns + strip.marker_mm,
                    "",
                )
            )
        for what, given_mm, key in asked:
            answer = self._ask(f"Measure with calipers or a tape: {what} in mm? (empty: skip) ").strip()
            if not answer:
                self._note(Finding(step="calipers", verdict="skipped", text=what))
                continue
            try:
                measured_mm = finite(answer)
            except ValueError:
                self._note(Finding(step="calipers", verdict="skipped", text=f"{what}: {answer!r} is not a number"))
                continue
            near = abs(measured_mm - given_mm) <= CALIPER_MM
            text = f"{what} {measured_mm:.2f} mm, in the scene {given_mm:.2f}"
            cure = (
                f"; correct {key}"
                if key
                else "; the scale of the printer is wrong: check its ruler, and use 'rhizotwin markers --printed-ruler-mm'"
            )
            self._found("calipers", near, text if near else text + cure, measured_mm=measured_mm, given_mm=given_mm)

    def _sighting(self) -> Sighting | None:
        return read_strip(self._jog.shot(), self._scene)

    def _cell_px(self) -> float:
        """Return the width of a marker cell in pixels in the first ring.

        A marker has 8 cells with its border (AprilTag 36h11: 10).
        """
        from rhizotwin.scenes.markers import dictionary_named

        lens, ring, strip = self._scene.camera.as_pinhole(), self._scene.plan.rings[0], self._scene.strip
        cells = int(dictionary_named(strip.dictionary).markerSize) + 2
        distance_mm = ring.distance_mm - self._scene.net_pot.outer_radius_mm
        return lens.focal_px[0] * strip.marker_mm / cells / distance_mm

    def _yes(self, question: str) -> bool:
        while True:
            answer = self._ask(f"{question} [yes/no] ").strip().lower()
            if answer in ("y", "yes", "n", "no"):
                return answer.startswith("y")
            self._say("answer yes or no")

    def _found(self, step: str, good: bool, text: str, **measured: float) -> None:
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
    """Return the findings as a Markdown report."""
    rows = [f"| {one.step} | {one.verdict} | {one.text.replace('|', '/')} |" for one in findings]
    wrong = sum(one.verdict == "wrong" for one in findings)
    head = [
        f"# First day of {name}",
        "",
        f"{len(findings)} steps, {wrong} failed.",
        "",
        "| step | verdict | finding |",
        "|---|---|---|",
    ]
    return "\n".join([*head, *rows, ""])


def edge_width_px(image: Grey) -> float:
    """Measure the width of the sharpest vertical edges in a picture in px.

    The width is the step from dark to bright divided by the steepest slope. The 99.9th percentile of the slopes is used
    instead of the maximum, so that single noisy pixels have no effect.
    """
    numbers = image.astype(np.float64)
    slope = np.abs(numbers[:, 2:] - numbers[:, :-2]) / 2.0
    low, high = np.percentile(numbers, (2.0, 98.0))
    return float((high - low) / max(float(np.percentile(slope, 99.9)), 1e-9))


def contrast(image: Grey) -> float:
    """Return the contrast: relative difference of the dark (2nd percentile) and the bright parts (98th percentile)."""
    dark, bright = np.percentile(image, (2.0, 98.0))
    return float(1.0 - dark / max(bright, 1.0))


def panel_evenness(image: Grey) -> float:
    """Return the brightness ratio of darker to brighter parts of the panel, in blocks that are mostly panel.

    It is the ratio of the 5th to the 95th percentile.
    """
    height, width = image.shape
    rows, columns = np.array_split(np.arange(height), BLOCKS_XY[1]), np.array_split(np.arange(width), BLOCKS_XY[0])
    blocks = np.array([[np.median(image[np.ix_(row, column)]) for column in columns] for row in rows])
    panel = blocks[blocks > 0.5 * np.percentile(blocks, 95.0)]
    dark, bright = np.percentile(panel, (5.0, 95.0))
    return float(dark / bright)
