"""The panel of the viewer: its buttons, sliders, lists and texts."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Literal

import numpy as np
import viser

from rhizotwin import root_colours
from rhizotwin.viewer import words
from rhizotwin.viewer.app import Viewer, ray_of, screen_of
from rhizotwin.viewer.drawing import CLICKS, LAYERS, TRUTH
from rhizotwin.viewer.scene3d import VIEWS

BEST_PICTURES = 3
"""Pictures offered for a selected root."""
_LABELS = {
    "surface": "Surface",
    "centre lines": "Centre lines",
    "tubes": "Roots as tubes",
    "voxels": "Voxels",
    "canister": "Canister, water and net pot",
    "cameras": "Cameras (click one to see its picture)",
    "truth": "True shape",
    "scale bar": "Scale bar",
}
_NO_ROOT, _NOW = "none", "now"
_AXES = ((2, "Height (mm)"), (0, "x (mm)"), (1, "y (mm)"))


def build(viewer: Viewer) -> None:
    """Build the panel and handle clicks into the scene."""
    server = viewer.served.server
    gui = server.gui
    gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False, control_width="medium")
    gui.main_panel.dock_right()
    head = gui.add_html("")
    message = gui.add_html("", visible=False)
    if len(viewer.names) > 1:
        _add_results(viewer)
    _add_selection(viewer)
    tabs = gui.add_tab_group()
    for name, add in (("View", _add_view), ("Edit", _add_edit), ("Pictures", _add_pictures), ("Traits", _add_traits)):
        with tabs.add_tab(name):
            add(viewer)

    def follow() -> None:
        session = viewer.shown.session
        head.content = words.volume(session.summary, session.measure(), edits=len(session.log.edits))
        message.content, message.visible = words.note(viewer.message), bool(viewer.message)

    viewer.on_change.append(follow)

    @server.scene.on_click()
    def _(event: viser.SceneClickEvent) -> None:
        viewer.clicked(ray_of(event.ray_origin, event.ray_direction))

    @server.scene.on_click(modifier="shift")
    def _(event: viser.SceneClickEvent) -> None:
        viewer.clicked(ray_of(event.ray_origin, event.ray_direction), more=True)

    @server.scene.on_rect_select(modifier="shift")
    def _(event: viser.SceneRectSelectEvent) -> None:
        viewer.select_rectangle(screen_of(event.client), event.screen_min, event.screen_max)

    viewer.changed()


def _add_results(viewer: Viewer) -> None:
    """Add the slider through several results, in the given order."""
    gui = viewer.served.server.gui
    number = gui.add_slider("Result", min=1, max=len(viewer.names), step=1, initial_value=1)
    name = gui.add_html(words.note(viewer.names[0]))

    @number.on_update
    def _(_: object) -> None:
        viewer.load(int(number.value) - 1)
        name.content = words.note(viewer.names[int(number.value) - 1])


def _add_selection(viewer: Viewer) -> None:
    """Add the list of roots, the description of the selection, and the pictures that show a selected root best."""
    gui = viewer.served.server.gui
    roots = gui.add_dropdown("Root", (_NO_ROOT,), hint="select a root from the list, or click it in the 3D view")
    selection = gui.add_html("")
    root = gui.add_html("", visible=False)
    best = [gui.add_button("", visible=False, hint="show this picture, with the root outlined in blue") for _ in range(BEST_PICTURES)]
    back = gui.add_button("Back to 3D", visible=False)
    places: list[int] = []

    @roots.on_update
    def _(_: object) -> None:
        picked = re.match(r"root (\d+)", str(roots.value))
        if picked and viewer.roots != [int(picked[1])]:
            viewer.select_root(int(picked[1]))
        elif not picked and viewer.roots:
            viewer.deselect()

    for rank, button in enumerate(best):

        def enter(_: object, rank: int = rank) -> None:
            viewer.enter_picture(places[rank])

        button.on_click(enter)
    back.on_click(lambda _: viewer.enter_picture(None))

    def follow() -> None:
        session = viewer.shown.session
        lines = session.state.lines
        there = [k for k in viewer.roots if k in lines]
        orders = root_colours.root_orders(lines)
        listed = (_NO_ROOT, *(words.root_name(k, line, orders[k]) for k, line in sorted(lines.items())))
        if roots.options != listed:
            roots.options = listed
        shown = words.root_name(there[0], lines[there[0]], orders[there[0]]) if len(there) == 1 else _NO_ROOT
        if roots.value != shown and (len(there) <= 1):
            _set_value(roots, shown)
        volumes = session.measure().volumes_mm3
        selected_mm3 = float(sum(volumes[row] for row in viewer.voxels))
        text = words.selection(len(there), sum(lines[k].length_mm for k in there), len(viewer.voxels), selected_mm3)
        if len(viewer.measured) == 2:
            a, b = viewer.measured
            text += words.note(f"Distance: {float(((a - b) ** 2).sum()) ** 0.5:.2f} mm")
        selection.content = text
        single = len(there) == 1
        pictures = viewer.shown.pictures
        places[:] = pictures.best_for(lines[there[0]], BEST_PICTURES) if single and pictures is not None else []
        if single:
            root.content = words.root(there[0], lines, orders[there[0]]) + words.profile(lines[there[0]])
        root.visible, back.visible = single, viewer.picture is not None
        for rank, button in enumerate(best):
            button.visible = rank < len(places)
            if pictures is not None and rank < len(places):
                button.label = f"Best seen in {PurePosixPath(pictures.files[places[rank]]).stem}"

    viewer.on_change.append(follow)


def _add_view(viewer: Viewer) -> None:
    """Add preset views, screenshot and movie, layers, colours and clipping."""
    gui = viewer.served.server.gui
    preset = gui.add_button_group("View", tuple(VIEWS))

    @preset.on_click
    def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
        for client in [event.client] if event.client is not None else viewer.served.server.get_clients().values():
            viewer.look_from(client, str(preset.value))

    _add_layers(viewer)
    _add_colours(viewer)
    _add_capture(viewer)
    with gui.add_folder("Clip", expand_by_default=False):
        _add_clipping(viewer)


def _add_layers(viewer: Viewer) -> None:
    gui, shown = viewer.served.server.gui, viewer.shown
    boxes: dict[str, viser.GuiCheckboxHandle] = {}
    for layer in LAYERS:
        if (layer == "truth" and shown.truth_file is None) or (layer in ("canister", "cameras") and shown.dataset is None):
            continue
        box = boxes[layer] = gui.add_checkbox(_LABELS[layer], initial_value=layer in viewer.look.layers)

        def switch(_: object, layer: str = layer, box: viser.GuiInputHandle[bool] = box) -> None:
            if (layer in viewer.look.layers) != bool(box.value):
                viewer.look.layers ^= {layer}
                viewer.refresh()

        box.on_update(switch)
    if shown.truth_file is not None:
        compare = gui.add_dropdown("True shape is", TRUTH)

        @compare.on_update
        def _(_: object) -> None:
            viewer.look.truth = str(compare.value)
            viewer.refresh()

    def follow() -> None:
        for layer, box in boxes.items():
            if box.value != (layer in viewer.look.layers):
                _set_value(box, layer in viewer.look.layers)

    viewer.on_change.append(follow)


def _add_colours(viewer: Viewer) -> None:
    gui = viewer.served.server.gui
    by = gui.add_dropdown("Colour by", root_colours.CHOICES, initial_value=viewer.look.colour)
    key = gui.add_html("")

    @by.on_update
    def _(_: object) -> None:
        viewer.look.colour = str(by.value)
        viewer.refresh()

    def follow() -> None:
        key.content = words.colour_key(root_colours.colour_roots(viewer.look.colour, viewer.shown.session.state.lines)[1])

    viewer.on_change.append(follow)


def _add_capture(viewer: Viewer) -> None:
    """Add the buttons that save a screenshot and a turntable movie."""
    from rhizotwin.viewer import capture

    gui = viewer.served.server.gui
    picture = gui.add_button("Save screenshot (PNG)")
    movie = gui.add_button("Save turntable movie (GIF)", hint="one rotation about the vertical axis, from the current distance and height")
    bar = gui.add_progress_bar(0.0, visible=False)
    recording = threading.Lock()

    def save(client: viser.ClientHandle | None, ending: str, make: Callable[[viser.ClientHandle], bytes]) -> None:
        if client is None or not recording.acquire(blocking=False):
            return
        picture.disabled = movie.disabled = True
        try:
            client.send_file_download(f"{viewer.shown.name}_{ending}", make(client), save_immediately=True)
        except (TimeoutError, RuntimeError) as error:
            viewer.notify(f"the browser rendered no picture ({error}); keep its window visible and try again")
        finally:
            picture.disabled = movie.disabled = bar.visible = False
            recording.release()

    def record(client: viser.ClientHandle) -> bytes:
        _set_value(bar, 0.0)
        bar.visible = True

        def progress(share: float) -> None:
            _set_value(bar, 100.0 * share)

        return capture.turntable(client, progress=progress)

    picture.on_click(lambda event: save(event.client, "view.png", capture.screenshot))
    movie.on_click(lambda event: save(event.client, "turntable.gif", record))


def _add_clipping(viewer: Viewer) -> None:
    """Add a slider for each axis that hides what is outside its range."""
    gui = viewer.served.server.gui
    centre = viewer.shown.session.measure().solid.centre_mm
    low, high = np.floor(centre.min(axis=0)) - 1.0, np.ceil(centre.max(axis=0)) + 1.0
    for axis, name in _AXES:
        ends = float(low[axis]), float(high[axis])
        slider = gui.add_multi_slider(name, min=ends[0], max=ends[1], step=0.1, initial_value=ends)

        def clip(_: object, axis: int = axis, slider: viser.GuiMultiSliderHandle[float] = slider, ends: tuple[float, float] = ends) -> None:
            below, above = slider.value
            viewer.clip(axis, None if below <= ends[0] else float(below), None if above >= ends[1] else float(above))

        slider.on_update(clip)


def _add_edit(viewer: Viewer) -> None:
    """Add the mode of clicks, the corrections, and their history."""
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
    """A button of a correction, with its keyboard shortcut."""

    label: str
    act: Callable[[], object]
    enabled: Callable[[], bool]
    hint: str = ""
    red: bool = False
    key: Literal["delete", "escape", "Z", "Y", "S"] | None = None
    modifier: Literal["cmd/ctrl"] | None = None


def _add_buttons(viewer: Viewer) -> None:
    """Add a button for each correction of the selection; it is disabled where it does not apply."""

    def some() -> bool:
        return bool(viewer.roots or viewer.voxels)

    def roots() -> bool:
        return bool(viewer.roots)

    def two() -> bool:
        return len(viewer.roots) == 2

    def deleted() -> bool:
        here, rows = viewer.shown.session.last_deleted()
        return bool(here) or len(rows) > 0

    lateral, join = "make the first selected root a lateral of the second", "make the second selected root the continuation of the first"
    clear = "clear the selection and the measurement"
    listed = [
        _Button("Delete (Del)", viewer.delete, some, "delete the selection", red=True, key="delete"),
        _Button(
            "Delete with laterals", lambda: viewer.delete(laterals=True), roots, "delete the selected roots and their laterals", red=True
        ),
        _Button("Restore the last deletion", viewer.restore, deleted, "restore the roots or voxels that were deleted last"),
        _Button("Join two", lambda: viewer.pair("join"), two, join),
        _Button("Make lateral of the second", lambda: viewer.pair("parent"), two, lateral),
        _Button("Refit", viewer.refit, lambda: viewer.shown.dataset is not None, "refit centre lines and diameters to the pictures"),
        _Button("Deselect (Esc)", viewer.deselect, lambda: some() or bool(viewer.measured), clear, key="escape"),
    ]
    _add_all(viewer, listed)


def _add_all(viewer: Viewer, listed: list[_Button]) -> None:
    gui = viewer.served.server.gui
    buttons = []
    for one in listed:
        button = gui.add_button(one.label, hint=one.hint or None, color="red" if one.red else None)

        def press(_: object, one: _Button = one) -> None:
            if one.enabled():
                one.act()

        button.on_click(press)
        buttons.append(button)
        if one.key is not None:
            gui.add_command(one.label.partition(" (")[0], hotkey=one.key, modifier=one.modifier).on_trigger(press)

    def follow() -> None:
        for button, one in zip(buttons, listed, strict=True):
            button.disabled = not one.enabled()

    viewer.on_change.append(follow)


def _add_box(viewer: Viewer) -> None:
    """Add selection and deletion of everything in a box."""
    gui = viewer.served.server.gui
    with gui.add_folder("Box", expand_by_default=False):
        low = gui.add_vector3("From (mm)", initial_value=(-10.0, -10.0, -60.0), step=0.1)
        high = gui.add_vector3("To (mm)", initial_value=(10.0, 10.0, -50.0), step=0.1)
        select = gui.add_button("Select voxels in the box")
        clear = gui.add_button("Delete everything in the box", color="red")

    @select.on_click
    def _(_: object) -> None:
        viewer.select_box(low.value, high.value)

    @clear.on_click
    def _(_: object) -> None:
        viewer.correct("delete box", box_mm=(tuple(low.value), tuple(high.value)))


def _add_history(viewer: Viewer) -> None:
    """Add undo, redo, save, and the list of corrections."""
    gui = viewer.served.server.gui

    _add_all(
        viewer,
        [
            _Button("Undo (Ctrl+Z)", viewer.undo, lambda: viewer.shown.session.can_undo, key="Z", modifier="cmd/ctrl"),
            _Button("Redo (Ctrl+Y)", viewer.redo, lambda: viewer.shown.session.can_redo, key="Y", modifier="cmd/ctrl"),
            _Button("Save corrections (Ctrl+S)", viewer.save, lambda: viewer.shown.session.unsaved > 0, key="S", modifier="cmd/ctrl"),
        ],
    )
    back = gui.add_dropdown("Undo to", (_NOW,), hint="undo all corrections after this one")
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
            _set_value(back, _NOW)
        history.content = words.history(edits)

    viewer.on_change.append(follow)


def _add_pictures(viewer: Viewer) -> None:
    """Add the buttons that step through the pictures."""
    gui = viewer.served.server.gui
    if viewer.shown.pictures is None:
        gui.add_html(words.note("The dataset was not found: start rhizotwin view RESULT DATASET."))
        return
    gui.add_html(words.note("The outline of the reconstruction is projected through the water into each picture."))
    step = gui.add_button_group("Picture", ("Previous", "Next", "Back to 3D"))
    name = gui.add_html("")

    @step.on_click
    def _(_: object) -> None:
        here = viewer.picture
        if step.value == "Back to 3D":
            viewer.enter_picture(None)
        else:
            viewer.enter_picture(0 if here is None else here + (1 if step.value == "Next" else -1))

    def follow() -> None:
        now = viewer.shown.pictures
        if viewer.picture is not None and now is not None:
            angle = now.table_deg[viewer.picture]
            name.content = words.note(
                now.files[viewer.picture] + ("" if angle is None else f", table at {round(angle, 1) % 360.0:.1f} degrees")
            )
        else:
            name.content = words.note(f"{0 if now is None else len(now.views)} pictures with cameras")

    viewer.on_change.append(follow)


def _add_traits(viewer: Viewer) -> None:
    """Add the table of traits of the edited result."""
    table = viewer.served.server.gui.add_html(words.note("Measuring ..."))

    def follow() -> None:
        session = viewer.shown.session
        table.content = words.traits(viewer.shown.traits(), edited=bool(session.log.edits), summary=session.summary)

    viewer.on_measured.append(follow)


def _set_value(handle: Any, value: object) -> None:
    """Set the value of an element; viser's annotations call it read-only."""
    handle.value = value
