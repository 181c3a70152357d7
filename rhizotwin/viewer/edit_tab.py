"""Panel tab "Edit": click mode, corrections and their history."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import viser

from rhizotwin.viewer import words
from rhizotwin.viewer.app import Viewer
from rhizotwin.viewer.drawing import set_value
from rhizotwin.viewer.look import CLICKS

_NOW = "now"


def add(viewer: Viewer) -> None:
    """Add the click mode, the buttons for corrections, and the history of corrections."""
    gui = viewer.served.server.gui
    mode = gui.add_dropdown("A click will", CLICKS)

    @mode.on_update
    def _(_: object) -> None:
        viewer.look.click = str(mode.value)

    _add_buttons(viewer)
    _add_box(viewer)
    _add_history(viewer)


@dataclass(frozen=True)
class _Button:
    """Button that applies a correction. It is also a command in the list that the key ? opens."""

    label: str
    """Text on the button."""
    icon: viser.IconName
    """Icon before the text."""
    act: Callable[[], object]
    """Function that is called when a user presses the button."""
    enabled: Callable[[], bool]
    """Function that returns whether the button is enabled."""
    hint: str
    """Description in the list of commands."""
    red: bool = False
    """Whether the button is red. Buttons that delete something are red."""
    key: Literal["delete", "escape", "Z", "Y", "S"] | None = None
    """Key of the keyboard shortcut."""
    modifier: Literal["cmd/ctrl"] | None = None
    """Modifier key of the keyboard shortcut."""


def _ctrl(key: str) -> dict[str, Any]:
    return {"key": key, "modifier": "cmd/ctrl"}


def _add_buttons(viewer: Viewer) -> None:
    """Add the buttons that correct the selection. A button is disabled if it does not apply to the selection."""

    def some() -> bool:
        return bool(viewer.roots or viewer.voxels)

    def roots() -> bool:
        return bool(viewer.roots)

    def two() -> bool:
        return len(viewer.roots) == 2

    def deleted() -> bool:
        return bool(viewer.shown.session.state.deletions)

    def pictures() -> bool:
        return viewer.shown.dataset is not None

    def chosen() -> bool:
        return some() or bool(viewer.measured)

    def with_laterals() -> None:
        viewer.delete(laterals=True)

    lateral, join = "make the first selected root a lateral of the second", "append the second selected root to the end of the first"
    restored = "restore the roots, parts of roots or voxels that were deleted last"
    icons = viser.Icon
    _add_all(
        viewer,
        [
            _Button("Join two", icons.LINK, lambda: viewer.pair("join"), two, join),
            _Button("Make lateral", icons.GIT_BRANCH, lambda: viewer.pair("parent"), two, lateral),
            _Button("Refit", icons.TARGET, viewer.refit, pictures, "refit centre lines and diameters to the pictures"),
            _Button("Deselect", icons.X, viewer.deselect, chosen, "clear the selection and the measurement", key="escape"),
        ],
    )
    viewer.served.server.gui.add_divider()
    _add_all(
        viewer,
        [
            _Button("Delete", icons.TRASH, viewer.delete, some, "delete the selection", red=True, key="delete"),
            _Button("With laterals", icons.TRASH, with_laterals, roots, "delete the selected roots and their laterals", red=True),
            _Button("Restore", icons.RESTORE, viewer.restore, deleted, restored),
        ],
    )


def _add_all(viewer: Viewer, listed: list[_Button]) -> None:
    gui = viewer.served.server.gui
    buttons = []
    for one in listed:
        button = gui.add_button(one.label, color="red" if one.red else None, icon=one.icon)

        def press(_: object, one: _Button = one) -> None:
            if one.enabled():
                one.act()

        button.on_click(press)
        buttons.append(button)
        gui.add_command(one.label, description=one.hint, hotkey=one.key, modifier=one.modifier, icon=one.icon).on_trigger(press)

    def follow() -> None:
        for button, one in zip(buttons, listed, strict=True):
            button.disabled = not one.enabled()

    viewer.on_change.append(follow)


def _add_box(viewer: Viewer) -> None:
    """Add the controls that select or delete everything in a box."""
    gui = viewer.served.server.gui
    with gui.add_folder("Box", expand_by_default=False):
        low = gui.add_vector3("From (mm)", initial_value=(-10.0, -10.0, -60.0), step=0.1)
        high = gui.add_vector3("To (mm)", initial_value=(10.0, 10.0, -50.0), step=0.1)
        select = gui.add_button("Select voxels", icon=viser.Icon.BOX)
        clear = gui.add_button("Delete all", color="red", icon=viser.Icon.TRASH)

    @select.on_click
    def _(_: object) -> None:
        viewer.select_box(low.value, high.value)

    @clear.on_click
    def _(_: object) -> None:
        viewer.correct("delete box", box_mm=(tuple(low.value), tuple(high.value)))


def _add_history(viewer: Viewer) -> None:
    """Add the buttons that undo, redo and save corrections, and the list of corrections."""
    gui = viewer.served.server.gui

    icons = viser.Icon
    gui.add_divider()
    _add_all(
        viewer,
        [
            _Button(
                "Undo", icons.ARROW_BACK_UP, viewer.undo, lambda: viewer.shown.session.can_undo, "undo the last correction", **_ctrl("Z")
            ),
            _Button(
                "Redo", icons.ARROW_FORWARD_UP, viewer.redo, lambda: viewer.shown.session.can_redo, "redo the correction", **_ctrl("Y")
            ),
            _Button(
                "Save", icons.DEVICE_FLOPPY, viewer.save, lambda: viewer.shown.session.unsaved > 0, "save the corrections", **_ctrl("S")
            ),
        ],
    )
    back = gui.add_dropdown("Undo to", (_NOW,), hint="undo this correction and all later corrections")
    history = gui.add_html("")

    @back.on_update
    def _(_: object) -> None:
        if str(back.value) != _NOW:
            viewer.undo_to(list(back.options)[::-1].index(str(back.value)))

    def follow() -> None:
        edits = viewer.shown.session.log.edits
        options = (_NOW, *(f"{k + 1}: before {words.edit(edits[k])}" for k in range(len(edits) - 1, -1, -1)))
        if back.options != options:
            back.options = options
        if back.value != _NOW:
            set_value(back, _NOW)
        history.content = words.history(edits)

    viewer.on_change.append(follow)
