"""Wiring diagrams of the electronics, with a list of connections for each of the two controllers.

Power supplies are drawn as labels at the pins, as is usual in circuit diagrams. Other connections are lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rhizotwin.rig.printing.print_page import Line, Page, Strokes, Text
from rhizotwin.rig.printing.print_page import Part as Ink
from rhizotwin.rig.rig_file import HatPart

PAGE_WIDE_MM = 297.0
PIN_MM = 5.4
"""Vertical distance between the pins of a box."""
LETTER_MM = 1.8
BOX_WIDE_MM = 62.0
COLUMNS_MM = (14.0, 168.0)
"""Positions of the left edges of the two columns of boxes, in mm."""


MODE_PINS = {1: (), 2: ("MODE0",), 4: ("MODE1",), 8: ("MODE0", "MODE1"), 16: ("MODE2",), 32: ("MODE0", "MODE2")}
"""High MODE pins of a DRV8825 for each number of microsteps per full step (data sheet, table 1)."""


@dataclass(frozen=True, kw_only=True)
class Wire:
    """Electrical connection between two pins, or between a power supply and a pin."""

    start: tuple[str, str]
    """Box and pin at the first end. For a power supply, the box is empty and the pin is the label of the supply."""
    end: tuple[str, str]
    """Box and pin at the second end."""
    note: str = ""
    """Component in the connection, such as a resistor, or a remark."""


@dataclass(frozen=True, kw_only=True)
class Diagram:
    """Wiring diagram of a rig's electronics."""

    title: str
    left: tuple[str, ...]
    """Names of the boxes in the left column, from top to bottom."""
    right: tuple[str, ...]
    """Names of the boxes in the right column, from top to bottom."""
    wires: tuple[Wire, ...]
    notes: tuple[str, ...]


SHIFTER, PANEL, FRONT_LAMP, MOTOR = "74AHCT125 level shifter", "panel, WS2812B", "front lamp, WS2812B", "stepper, NEMA 17"


def marlin_diagram() -> Diagram:
    """Return the wiring diagram of a rig with a Marlin controller board."""
    board, computer, adapter, arm = "Marlin board", "computer", "LX bus adapter", "arm, LX servos"
    return Diagram(
        title="Marlin board, arm on its own bus adapter",
        left=(computer, board, adapter),
        right=(MOTOR, SHIFTER, PANEL, FRONT_LAMP, arm),
        wires=(
            Wire(start=(computer, "USB 1"), end=(board, "USB")),
            Wire(start=(computer, "USB 2"), end=(adapter, "USB")),
            *(
                Wire(start=(board, f"X {coil}"), end=(MOTOR, coil), note="coil" if coil == "A+" else "")
                for coil in ("A+", "A-", "B+", "B-")
            ),
            Wire(start=(board, "NEOPIXEL_PIN"), end=(SHIFTER, "1A")),
            Wire(start=(board, "NEOPIXEL2_PIN"), end=(SHIFTER, "2A")),
            *_lamps(),
            Wire(start=("", "+12 V"), end=(board, "motor supply +")),
            Wire(start=("", "GND"), end=(board, "GND")),
            Wire(start=(adapter, "bus signal"), end=(arm, "signal")),
            Wire(start=("", "+7.5 V arm"), end=(arm, "V+")),
            Wire(start=("", "GND"), end=(arm, "GND")),
            Wire(start=("", "GND"), end=(adapter, "GND")),
        ),
        notes=(
            "Connect the grounds of LED supply, motor supply, arm supply and board.",
            "Panel: feed 5 V at both ends and every metre, 1000 uF across the supply, 20 A for 300 LEDs.",
            "Motor driver at about 1 A; lower currents give uneven microsteps. Never connect the motor while it is powered.",
            "The arm has its own supply, because a stalled servo would reduce the voltage of the LEDs.",
        ),
    )


def hat_diagram(part: HatPart) -> Diagram:
    """Return the wiring diagram of the thesis's rig (section 3.4).

    A Raspberry Pi with an expansion board (hat) controls a DRV8825 motor driver and NeoPixel LEDs.
    """
    pi, driver, adapter, arm = "Raspberry Pi", "DRV8825", "LX bus adapter", "arm, LX servos"
    modes = MODE_PINS[part.microsteps]
    return Diagram(
        title="Raspberry Pi with the thesis's hat: DRV8825 and NeoPixels on GPIO",
        left=(pi, adapter),
        right=(driver, MOTOR, SHIFTER, PANEL, FRONT_LAMP, arm),
        wires=(
            Wire(start=(pi, f"GPIO{part.step_pin}"), end=(driver, "STEP")),
            Wire(start=(pi, f"GPIO{part.direction_pin}"), end=(driver, "DIR")),
            Wire(start=(pi, f"GPIO{part.enable_pin}"), end=(driver, "nENABLE"), note="10 k to 3.3 V: off at power-up"),
            Wire(start=(pi, f"GPIO{part.fault_pin}"), end=(driver, "nFAULT"), note="10 k to 3.3 V"),
            *(Wire(start=("", "+3.3 V"), end=(driver, pin)) for pin in ("nSLEEP, nRESET", ", ".join(modes)) if pin),
            Wire(start=("", "+12 V"), end=(driver, "VMOT"), note="100 uF at the pin"),
            Wire(start=("", "GND"), end=(driver, "GND")),
            *(Wire(start=(driver, one), end=(MOTOR, coil)) for one, coil in (("A1", "A+"), ("A2", "A-"), ("B1", "B+"), ("B2", "B-"))),
            Wire(start=(pi, f"GPIO{part.panel_pin}"), end=(SHIFTER, "1A")),
            Wire(start=(pi, f"GPIO{part.front_pin}"), end=(SHIFTER, "2A")),
            *_lamps(),
            Wire(start=(pi, "USB"), end=(adapter, "USB")),
            Wire(start=("", "GND"), end=(pi, "GND")),
            Wire(start=("", "GND"), end=(adapter, "GND")),
            Wire(start=(adapter, "bus signal"), end=(arm, "signal")),
            Wire(start=("", "+7.5 V arm"), end=(arm, "V+")),
            Wire(start=("", "GND"), end=(arm, "GND")),
        ),
        notes=(
            f"{' and '.join(modes) or 'No MODE pin'} high, the others open: 1/{part.microsteps} step (DRV8825 data sheet, table 1).",
            "Vref sets the current: 0.5 V for 1 A with 0.1 ohm sense resistors.",
            "GPIO18 and GPIO13 are the two PWM channels of rpi_ws281x: disable audio (dtparam=audio=off).",
            "Figure 3.4 of the thesis does not name the pins; those shown are those of [hat] in the rig file, or its defaults.",
        ),
    )


def _lamps() -> tuple[Wire, ...]:
    return (
        Wire(start=(SHIFTER, "1Y"), end=(PANEL, "DIN"), note="330 ohm"),
        Wire(start=(SHIFTER, "2Y"), end=(FRONT_LAMP, "DIN"), note="330 ohm"),
        Wire(start=("", "+5 V LED"), end=(SHIFTER, "VCC")),
        Wire(start=("", "GND"), end=(SHIFTER, "GND, 1OE, 2OE")),
        *(Wire(start=("", label), end=(lamp, pin)) for lamp in (PANEL, FRONT_LAMP) for label, pin in (("+5 V LED", "5 V"), ("GND", "GND"))),
    )


def wiring_pages(hat: HatPart) -> dict[str, Page]:
    """Return the wiring diagram of each controller, with the keys ``marlin`` and ``hat``."""
    return {"marlin": page_of(marlin_diagram()), "hat": page_of(hat_diagram(hat))}


def page_of(diagram: Diagram) -> Page:
    """Draw a diagram with boxes in two columns, lines for connections and labels for power supplies."""
    pins = {name: _pins(diagram, name) for name in (*diagram.left, *diagram.right)}
    ink: list[Ink] = [Text(at_mm=(14.0, 12.0), text=diagram.title, height_mm=2.8)]
    places: dict[tuple[str, str], tuple[float, float]] = {}
    outer: dict[tuple[str, str], float] = {}
    low = 0.0
    for column, names in enumerate((diagram.left, diagram.right)):
        x = COLUMNS_MM[column]
        y = 20.0
        for name in names:
            high = PIN_MM * (len(pins[name]) + 1.2)
            corners = np.array([[x, y], [x + BOX_WIDE_MM, y], [x + BOX_WIDE_MM, y + high], [x, y + high], [x, y]])
            ink += [
                Strokes(lines_mm=(corners,), width_mm=0.3),
                Text(at_mm=(x + BOX_WIDE_MM / 2.0, y + 3.6), text=name, height_mm=2.1, align="center"),
            ]
            for row, pin in enumerate(pins[name]):
                at = y + PIN_MM * (row + 1.5)
                inner = x + BOX_WIDE_MM if column == 0 else x
                places[name, pin] = inner, at
                outer[name, pin] = x if column == 0 else x + BOX_WIDE_MM
                align: Literal["left", "right"] = "right" if column == 0 else "left"
                ink.append(Text(at_mm=(inner + (-1.5 if column == 0 else 1.5), at + 0.8), text=pin, height_mm=LETTER_MM, align=align))
            y += high + 5.0
        low = max(low, y + 4.0)
    ink += _lines(diagram.wires, places, outer)
    ink += [Text(at_mm=(14.0, low + 4.0 * k), text=note, height_mm=1.9) for k, note in enumerate(diagram.notes)]
    return Page(size_mm=(PAGE_WIDE_MM, low + 4.0 * len(diagram.notes) + 4.0), parts=tuple(ink))


def _pins(diagram: Diagram, name: str) -> list[str]:
    """Return the pins of a box in the order of the list of connections."""
    ends = [end for wire in diagram.wires for end in (wire.start, wire.end) if end[0] == name]
    return list(dict.fromkeys(pin for _, pin in ends))


def _lines(wires: Sequence[Wire], places: dict[tuple[str, str], tuple[float, float]], outer: dict[tuple[str, str], float]) -> list[Ink]:
    ink: list[Ink] = []
    drawn = [wire for wire in wires if wire.start[0]]
    gap = (COLUMNS_MM[0] + BOX_WIDE_MM, COLUMNS_MM[1])
    across = [wire for wire in drawn if places[wire.start][0] != places[wire.end][0]]
    for wire in drawn:
        (x0, y0), (x1, y1) = places[wire.start], places[wire.end]
        if wire in across:
            lane = gap[0] + 26.0 + (gap[1] - gap[0] - 52.0) * (across.index(wire) + 0.5) / len(across)
            path = [[x0, y0], [lane, y0], [lane, y1], [x1, y1]]
            note = (lane + 1.0, y1 - 0.8)
        else:  # both ends are in one column, so the line is routed along its outer side
            edge = outer[wire.start]
            side = -1.0 if edge < x0 else 1.0
            lane = edge + side * (3.0 + 1.6 * [w for w in drawn if w not in across].index(wire))
            path = [[edge, y0], [lane, y0], [lane, y1], [edge, y1]]
            note = (edge + (1.0 if side > 0.0 else -9.0), y1 - 0.8)
        ink.append(Strokes(lines_mm=(np.array(path),), width_mm=0.2))
        if wire.note:
            ink.append(Text(at_mm=note, text=wire.note, height_mm=1.5, grey=0.3))
    for wire in wires:
        if not wire.start[0]:
            ink += _supply(wire, places[wire.end], left=outer[wire.end] < places[wire.end][0])
    return ink


def _supply(wire: Wire, at: tuple[float, float], *, left: bool) -> list[Ink]:
    """Draw the label of a power supply at a pin."""
    way = 1.0 if left else -1.0
    end = at[0] + way * 4.0
    text = f"{wire.start[1]}  ({wire.note})" if wire.note else wire.start[1]
    label = Text(at_mm=(end + way * 0.8, at[1] + 0.7), text=text, height_mm=1.6, align="left" if left else "right", grey=0.25)
    return [Line(from_mm=at, to_mm=(end, at[1]), width_mm=0.2), label]
