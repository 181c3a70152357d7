"""The first day of a real rig.

A person is walked through what no emulation can tell, and a report is written to be sent back.
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
"""A single picture tells the table's angle to a few tenths; a wrong direction is 18 degrees off, a wrong gear ratio
several."""
BLOCKS_XY = (16, 12)
LEAST_CONTRAST = 0.3
"""Dark over bright in a picture with anything before the panel: the pot alone takes nearly all light; an empty panel
fades by less (`LEAST_EVEN` is for its corners)."""
LEAST_EVEN = 0.6
"""Darkest over brightest part of the panel: the reconstruction divides it out, but photons are lost."""
CALIPER_MM = 0.3
"""0.3 mm across the pot of 159 is 0.2 % of every length and 0.6 % of the volume."""
JOINTS = (
    "the base turn counter-clockwise, seen from above",
    *[f"the {name} lean toward the canister" for name in ("shoulder", "elbow", "wrist")],
    "the camera roll, and nothing else move",
)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What one step of the walk found."""

    step: str
    verdict: str
    """``ok``, ``wrong`` or ``skipped``."""
    text: str
    measured: dict[str, float] = field(default_factory=dict)


class FirstDay:
    """A walk through a rig."""

    def __init__(self, devices: Devices, scene: Scene, *, ask: Ask, say: Say, folder: Path) -> None:
        self._scene, self._ask, self._say, self._folder = scene, ask, say, folder
        self._devices = devices
        self._jog = Jog(devices, scene, say=say)
        self._before_canister = devices.arm is None
        """Whether the camera stands where it sees strip and water: a tripod does."""
        self.findings: list[Finding] = []

    def walk(self, *, wrong_devices: int) -> list[Finding]:
        """Go through the list; the rig is left safe, and what was found until then is written, whatever happens.

        Parameters
        ----------
        wrong_devices : int
            How many things `rig.bench.check` found wrong.
        """
        self._found("devices", wrong_devices == 0, f"{wrong_devices} wrong; see the lines above" if wrong_devices else "all answer")
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
        self._found(
            "lamps",
            self._yes("Are the whole panel and the front lamp lit, evenly to the eye and without flicker?"),
            "as a person sees them",
        )

    def _arm(self) -> None:
        """Bring the camera before the canister, once every joint is known to go the right way."""
        if self._devices.arm is None:
            self._note(Finding(step="arm", verdict="skipped", text="this rig has no arm"))
            return
        if any(one.verdict != "ok" for one in self.findings if one.step.startswith("joint")):
            self._note(
                Finding(step="arm", verdict="skipped", text="it goes nowhere before all joints are ok; put them right and walk again")
            )
            return
        ring = self._scene.plan.rings[0]
        where = f"{ring.distance_mm:g} mm from the axis, {ring.height_mm:g} mm above the rim"
        if not self._yes(f"A hand on the switch: may the arm bring the camera before the canister ({where})?"):
            self._note(Finding(step="arm", verdict="skipped", text="not moved"))
            return
        self._jog.do(["go", f"{ring.distance_mm:g}", f"{ring.height_mm:g}", f"{ring.tilt_deg:g}"])
        self._before_canister = self._yes("Does the camera look squarely at the canister, strip and water in the picture?")
        self._found("arm", self._before_canister, f"as a person sees it: {where}")

    def _out_of_place(self, step: str) -> bool:
        """Skip a step whose picture would not show the canister."""
        if not self._before_canister:
            self._note(Finding(step=step, verdict="skipped", text="the camera does not stand before the canister"))
        return not self._before_canister

    def _focus(self) -> None:
        if self._out_of_place("focus"):
            return
        image = self._jog.shot()
        write_bytes(self._folder / "focus.png", encode_png(image))
        if contrast(image) < LEAST_CONTRAST:
            self._found("focus", False, "nothing dark stands before the panel: bring pot, strip and canister into the picture (focus.png)")
            return
        width_px, cell_px = edge_width_px(image), self._cell_px()
        sharp = width_px < 0.5 * cell_px
        text = f"the sharpest edges are {width_px:.1f} px wide, a cell of a marker {cell_px:.1f} px"
        cure = "; turn the focus until edges are less than half a cell wide"
        self._found("focus", sharp, text if sharp else text + cure, edge_px=width_px, cell_px=cell_px)

    def _strip(self) -> None:
        if self._out_of_place("strip"):
            return
        image = self._jog.shot()
        seen = read_strip(image, self._scene)
        if seen is not None:
            self._found("strip", True, f"{seen.markers} markers, {seen.reprojection_px:.2f} px off", reprojection_px=seen.reprojection_px)
        elif read_strip(np.ascontiguousarray(image[:, ::-1]), self._scene) is not None:
            self._found(
                "strip", False, "the picture is mirrored: switch off the camera's flip, or print the strip anew if it was printed mirrored"
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
        text = f"its darker parts have {100.0 * even:.0f} % of the light of its brighter ones, {100.0 * full:.1f} % is at full scale"
        self._found("panel", good, text, evenness=even, saturated=full)
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
            self._found("table", seen_right, "as a person sees it; the markers could not be read")
            return
        turn, miss = (wrapped(facing_angle(b, self._scene) - facing_angle(a, self._scene)) for a, b in ((before, after), (before, back)))
        measured = abs(turn - TURN_DEG) <= TURN_TOLERANCE_DEG
        text = f"told to turn by {TURN_DEG:g} deg, the markers turned by {turn:.2f}, and came back to {miss:+.2f}"
        if abs(turn + TURN_DEG) <= TURN_TOLERANCE_DEG:
            text += ": the other way; swap the motor's coil, set INVERT_X_DIR or hat.reverse, or turntable.direction = -1 in the scene"
        elif not measured:
            text += ": correct the steps per degree"
        elif not seen_right:
            text += f"; by the markers it is right, but a person saw no turn {sense}: is the strip upside down?"
        self._found("table", measured and seen_right, text, turned_deg=turn, back_deg=miss)

    def _joint_step(self, k: int) -> Callable[[], None]:
        def step() -> None:
            arm = self._devices.arm
            name = f"joint {k + 1}"
            if arm is None:
                self._note(Finding(step=name, verdict="skipped", text="this rig has no arm"))
                return
            if not self._yes(f"A hand on the switch of the arm's supply: may joint {k + 1} move by {JOINT_DEG:g} degrees?"):
                self._note(Finding(step=name, verdict="skipped", text="not moved"))
                return
            self._jog.do(["joint", str(k + 1), "+0"])  # connects
            before = arm.read_joints()[k]
            self._jog.do(["joint", str(k + 1), f"+{JOINT_DEG:g}"])
            moved_deg = arm.read_joints()[k] - before
            right = self._yes(f"Did {JOINTS[k]}?")
            self._jog.do(["joint", str(k + 1), f"-{JOINT_DEG:g}"])
            text = f"told to move by {JOINT_DEG:g} deg, the servo says {moved_deg:+.1f}"
            self._found(name, right, text + ("" if right else f"; set sign of arm.joints {k + 1} to the other one"), moved_deg=moved_deg)

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
            answer = self._ask(f"Calipers or tape: how many mm is it {what}? (nothing: skip) ").strip()
            if not answer:
                self._note(Finding(step="calipers", verdict="skipped", text=what))
                continue
            try:
                measured_mm = finite(answer)
            except ValueError:
                self._note(Finding(step="calipers", verdict="skipped", text=f"{what}: {answer!r} is no number"))
                continue
            near = abs(measured_mm - given_mm) <= CALIPER_MM
            text = f"{what} {measured_mm:.2f} mm, in the scene {given_mm:.2f}"
            cure = f"; correct {key}" if key else "; the printer scales: see its ruler, and `rhizotwin markers --printed-ruler-mm`"
            self._found("calipers", near, text if near else text + cure, measured_mm=measured_mm, given_mm=given_mm)

    def _sighting(self) -> Sighting | None:
        return read_strip(self._jog.shot(), self._scene)

    def _cell_px(self) -> float:
        """Return how many pixels a cell of a marker has from the first ring.

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
    """Return the findings as a page to be sent back."""
    rows = [f"| {one.step} | {one.verdict} | {one.text.replace('|', '/')} |" for one in findings]
    wrong = sum(one.verdict == "wrong" for one in findings)
    head = [
        f"# First day of {name}",
        "",
        f"{len(findings)} steps, {wrong} wrong.",
        "",
        "| step | verdict | what was found |",
        "|---|---|---|",
    ]
    return "\n".join([*head, *rows, ""])


def edge_width_px(image: Grey) -> float:
    """Return how wide the picture's sharpest upright edges are, in px.

    The step from dark to bright over the steepest slope.

    The 99.9th percentile of the slopes stands for the steepest, so that single noisy pixels do not count.
    """
    numbers = image.astype(np.float64)
    slope = np.abs(numbers[:, 2:] - numbers[:, :-2]) / 2.0
    low, high = np.percentile(numbers, (2.0, 98.0))
    return float((high - low) / max(float(np.percentile(slope, 99.9)), 1e-9))


def contrast(image: Grey) -> float:
    """Return by what share of the bright parts' light (98th percentile) the dark ones (2nd) are darker."""
    dark, bright = np.percentile(image, (2.0, 98.0))
    return float(1.0 - dark / max(bright, 1.0))


def panel_evenness(image: Grey) -> float:
    """Return the light of the panel's darker parts over its brighter ones', in blocks that are mostly panel.

    The 5th percentile over the 95th.
    """
    height, width = image.shape
    rows, columns = np.array_split(np.arange(height), BLOCKS_XY[1]), np.array_split(np.arange(width), BLOCKS_XY[0])
    blocks = np.array([[np.median(image[np.ix_(row, column)]) for column in columns] for row in rows])
    panel = blocks[blocks > 0.5 * np.percentile(blocks, 95.0)]
    dark, bright = np.percentile(panel, (5.0, 95.0))
    return float(dark / bright)
