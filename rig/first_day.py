"""Guided first check of a real rig.

The user is guided through tests that no emulation can replace; the results are written to a report.
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
"""Tolerance of the table's angle: a single picture measures it to a few tenths of a degree; a wrong direction causes an
error of 18 degrees, a wrong gear ratio of several."""
BLOCKS_XY = (16, 12)
LEAST_CONTRAST = 0.3
"""Minimum relative darkness of objects in front of the panel: the pot absorbs nearly all light, an empty panel varies
by less (`LEAST_EVEN` applies to its corners)."""
LEAST_EVEN = 0.6
"""Minimum ratio of the darkest to the brightest part of the panel: the reconstruction corrects for it, but photons are
lost."""
CALIPER_MM = 0.3
"""Tolerance of calliper measurements: 0.3 mm in the pot's 159 mm is 0.2 % of every length and 0.6 % of the volume."""
JOINTS = (
    "the base turn counter-clockwise, seen from above",
    *[f"the {name} lean toward the canister" for name in ("shoulder", "elbow", "wrist")],
    "the camera roll, and nothing else move",
)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one step."""

    step: str
    verdict: str
    """``ok``, ``wrong`` or ``skipped``."""
    text: str
    measured: dict[str, float] = field(default_factory=dict)


class FirstDay:
    """Guided check of a rig."""

    def __init__(self, devices: Devices, scene: Scene, *, ask: Ask, say: Say, folder: Path) -> None:
        self._scene, self._ask, self._say, self._folder = scene, ask, say, folder
        self._devices = devices
        self._jog = Jog(devices, scene, say=say)
        self._before_canister = devices.arm is None
        """Whether strip and water are in the camera's view, as for a tripod."""
        self.findings: list[Finding] = []

    def walk(self, *, wrong_devices: int) -> list[Finding]:
        """Run all steps. On errors too, the rig is left in a safe state, and previous results are written.

        Parameters
        ----------
        wrong_devices : int
            Number of problems found by `rig.bench.check`.
        """
        self._record_finding(
            "devices", wrong_devices == 0, f"{wrong_devices} wrong; see the lines above" if wrong_devices else "all answer"
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
        """Move the camera in front of the canister, after every joint is known to move in the right direction."""
        if self._devices.arm is None:
            self._note(Finding(step="arm", verdict="skipped", text="this rig has no arm"))
            return
        if any(one.verdict != "ok" for one in self.findings if one.step.startswith("joint")):
            self._note(Finding(step="arm", verdict="skipped", text="not moved before all joints are ok; correct them and repeat"))
            return
        ring = self._scene.plan.rings[0]
        where = f"{ring.distance_mm:g} mm from the axis, {ring.height_mm:g} mm above the rim"
        if not self._yes(f"Keep a hand on the switch: may the arm move the camera in front of the canister ({where})?"):
            self._note(Finding(step="arm", verdict="skipped", text="not moved"))
            return
        self._jog.do(["go", f"{ring.distance_mm:g}", f"{ring.height_mm:g}", f"{ring.tilt_deg:g}"])
        self._before_canister = self._yes("Does the camera face the canister, with strip and water in the picture?")
        self._record_finding("arm", self._before_canister, f"judged by eye: {where}")

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
            self._record_finding(
                "focus", False, "there is no dark object in front of the panel: bring pot, strip and canister into the picture (focus.png)"
            )
            return
        width_px, cell_px = edge_width_px(image), self._cell_px()
        sharp = width_px < 0.5 * cell_px
        text = f"the sharpest edges are {width_px:.1f} px wide, a cell of a marker {cell_px:.1f} px"
        cure = "; turn the focus until edges are less than half a cell wide"
        self._record_finding("focus", sharp, text if sharp else text + cure, edge_px=width_px, cell_px=cell_px)

    def _strip(self) -> None:
        if self._out_of_place("strip"):
            return
        image = self._jog.shot()
        seen = read_strip(image, self._scene)
        if seen is not None:
            self._record_finding(
                "strip", True, f"{seen.markers} markers, {seen.reprojection_px:.2f} px error", reprojection_px=seen.reprojection_px
            )
        elif read_strip(np.ascontiguousarray(image[:, ::-1]), self._scene) is not None:
            self._record_finding(
                "strip", False, "the picture is mirrored: switch off the camera's flip, or print the strip anew if it was printed mirrored"
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
        text = f"its darker parts have {100.0 * even:.0f} % of the light of its brighter ones, {100.0 * full:.1f} % is at full scale"
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
        text = f"commanded to turn by {TURN_DEG:g} deg, the markers turned by {turn:.2f} and returned to {miss:+.2f}"
        if abs(turn + TURN_DEG) <= TURN_TOLERANCE_DEG:
            text += ": wrong direction; swap the motor's coil, set INVERT_X_DIR or hat.reverse, or turntable.direction = -1 in the scene"
        elif not measured:
            text += ": correct the steps per degree"
        elif not seen_right:
            text += f"; the markers confirm it, but no turn {sense} was observed: is the strip upside down?"
        self._record_finding("table", measured and seen_right, text, turned_deg=turn, back_deg=miss)

    def _joint_step(self, k: int) -> Callable[[], None]:
        def step() -> None:
            arm = self._devices.arm
            name = f"joint {k + 1}"
            if arm is None:
                self._note(Finding(step=name, verdict="skipped", text="this rig has no arm"))
                return
            if not self._yes(f"Keep a hand on the switch of the arm's supply: may joint {k + 1} move by {JOINT_DEG:g} degrees?"):
                self._note(Finding(step=name, verdict="skipped", text="not moved"))
                return
            self._jog.do(["joint", str(k + 1), "+0"])  # connects
            before = arm.read_joints()[k]
            self._jog.do(["joint", str(k + 1), f"+{JOINT_DEG:g}"])
            moved_deg = arm.read_joints()[k] - before
            right = self._yes(f"Did {JOINTS[k]}?")
            self._jog.do(["joint", str(k + 1), f"-{JOINT_DEG:g}"])
            text = f"commanded to move by {JOINT_DEG:g} deg, the servo reports {moved_deg:+.1f}"
            self._record_finding(
                name, right, text + ("" if right else f"; set sign of arm.joints {k + 1} to the other one"), moved_deg=moved_deg
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
            answer = self._ask(f"Callipers or tape: how many mm is it {what}? (empty to skip) ").strip()
            if not answer:
                self._note(Finding(step="calipers", verdict="skipped", text=what))
                continue
            try:
                measured_mm = parse_number(answer)
            except ValueError:
                self._note(Finding(step="calipers", verdict="skipped", text=f"{what}: {answer!r} is not a number"))
                continue
            near = abs(measured_mm - given_mm) <= CALIPER_MM
            text = f"{what} {measured_mm:.2f} mm, in the scene {given_mm:.2f}"
            cure = f"; correct {key}" if key else "; the printer scales: see its ruler, and `rhizotwin markers --printed-ruler-mm`"
            self._record_finding("calipers", near, text if near else text + cure, measured_mm=measured_mm, given_mm=given_mm)

    def _sighting(self) -> Sighting | None:
        return read_strip(self._jog.shot(), self._scene)

    def _cell_px(self) -> float:
        """Return the size in pixels of a marker's cell from the first ring.

        A marker has 8 cells including its border (AprilTag 36h11: 10).
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
    """Return the results as a Markdown report."""
    rows = [f"| {one.step} | {one.verdict} | {one.text.replace('|', '/')} |" for one in findings]
    wrong = sum(one.verdict == "wrong" for one in findings)
    head = [
        f"# First day of {name}",
        "",
        f"{len(findings)} steps, {wrong} wrong.",
        "",
        "| step | verdict | result |",
        "|---|---|---|",
    ]
    return "\n".join([*head, *rows, ""])


def edge_width_px(image: Grey) -> float:
    """Return the width in px of the sharpest vertical edges: the step from dark to bright over the steepest slope.

    The 99.9th percentile of the slopes is used, so that single noisy pixels have no effect.
    """
    numbers = image.astype(np.float64)
    slope = np.abs(numbers[:, 2:] - numbers[:, :-2]) / 2.0
    low, high = np.percentile(numbers, (2.0, 98.0))
    return float((high - low) / max(float(np.percentile(slope, 99.9)), 1e-9))


def contrast(image: Grey) -> float:
    """Return the relative difference between the bright (98th percentile) and the dark parts (2nd) of a picture."""
    dark, bright = np.percentile(image, (2.0, 98.0))
    return float(1.0 - dark / max(bright, 1.0))


def panel_evenness(image: Grey) -> float:
    """Return the ratio of the panel's darker to its brighter parts, in blocks that are mostly panel.

    These are the 5th and the 95th percentile.
    """
    height, width = image.shape
    rows, columns = np.array_split(np.arange(height), BLOCKS_XY[1]), np.array_split(np.arange(width), BLOCKS_XY[0])
    blocks = np.array([[np.median(image[np.ix_(row, column)]) for column in columns] for row in rows])
    panel = blocks[blocks > 0.5 * np.percentile(blocks, 95.0)]
    dark, bright = np.percentile(panel, (5.0, 95.0))
    return float(dark / bright)
