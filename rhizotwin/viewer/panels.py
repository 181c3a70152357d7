"""The panel beside the 3D view: buttons, sliders and what they say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import PurePosixPath
from typing import Literal

import numpy as np
import viser

from rhizotwin.viewer import colours, words
from rhizotwin.viewer.app import Viewer, ray_of, screen_of
from rhizotwin.viewer.drawing import CLICKS, LAYERS, TRUTH

RANKS = ("First", "Second", "Third")
"""Pictures offered of a chosen root."""
_FIRST = {
    "roots": "Roots",
    "surface": "Surface",
    "voxels": "Voxels",
    "canister": "Canister, water and net pot",
    "cameras": "Cameras (click one to stand in it)",
    "truth": "Truth",
}


def build(viewer: Viewer) -> None:
    """Make the panel and answer clicks into the scene."""
    server = viewer.served.server
    gui = server.gui
    gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False, control_width="medium")
    gui.main_panel.dock_right()
    head = gui.add_html("")
    said = gui.add_html("", visible=False)
    _chosen(viewer)
    if len(viewer.names) > 1:
        _days(viewer)
    tabs = gui.add_tab_group()
    with tabs.add_tab("Look"):
        _look(viewer)
    with tabs.add_tab("Correct"):
        _correct(viewer)
    with tabs.add_tab("Pictures"):
        _pictures(viewer)
    with tabs.add_tab("Traits"):
        _traits(viewer)

    def follow() -> None:
        session = viewer.shown.session
        head.content = words.volume(session.summary, session.measure(), edits=len(session.log.edits))
        said.content, said.visible = words.note(viewer.told), bool(viewer.told)

    viewer.on_change.append(follow)

    @server.scene.on_click()
    def _(event: viser.SceneClickEvent) -> None:
        viewer.clicked(ray_of(event.ray_origin, event.ray_direction))

    @server.scene.on_click(modifier="shift")
    def _(event: viser.SceneClickEvent) -> None:
        viewer.clicked(ray_of(event.ray_origin, event.ray_direction), more=True)

    @server.scene.on_rect_select(modifier="shift")
    def _(event: viser.SceneRectSelectEvent) -> None:
        viewer.choose_rectangle(screen_of(event.client), event.screen_min, event.screen_max)

    viewer.changed()


def _chosen(viewer: Viewer) -> None:
    """Make what tells of the chosen, and of a chosen root in how much detail."""
    gui = viewer.served.server.gui
    chosen = gui.add_html("")
    root = gui.add_html("", visible=False)
    pictures = gui.add_button_group("Seen best in", RANKS, visible=False, hint="stand in this picture, the root drawn over it in orange")
    back = gui.add_button("Back to 3D", visible=False)
    best: list[int] = []

    @pictures.on_click
    def _(_: object) -> None:
        rank = RANKS.index(str(pictures.value))
        if rank < len(best):
            viewer.stand(best[rank])

    back.on_click(lambda _: viewer.stand(None))

    def follow() -> None:
        session = viewer.shown.session
        lines = session.state.lines
        there = [k for k in viewer.roots if k in lines]
        volumes = session.measure().volumes_mm3
        taken = float(sum(volumes[row] for row in viewer.voxels))
        told = words.chosen(len(there), sum(lines[k].length_mm for k in there), len(viewer.voxels), taken)
        if len(viewer.measured) == 2:
            a, b = viewer.measured
            told += words.note(f"{float(((a - b) ** 2).sum()) ** 0.5:.2f} mm between the two points")
        chosen.content = told
        alone = len(there) == 1
        if alone:
            number = there[0]
            shown = viewer.shown.pictures
            best[:] = [] if shown is None else shown.best_for(lines[number], len(RANKS))
            names = [] if shown is None else [PurePosixPath(shown.files[place]).stem for place in best]
            root.content = words.root(number, lines, colours.order_of(lines)[number], names) + words.profile(lines[number])
        root.visible = alone
        pictures.visible = alone and bool(best)
        back.visible = viewer.standing is not None

    viewer.on_change.append(follow)


def _traits(viewer: Viewer) -> None:
    """Tell the traits as they are now, corrections counted."""
    told = viewer.served.server.gui.add_html("")

    def follow() -> None:
        told.content = words.traits(
            viewer.shown.traits(), corrected=bool(viewer.shown.session.log.edits), summary=viewer.shown.session.summary
        )

    viewer.on_drawn.append(follow)


def _days(viewer: Viewer) -> None:
    """Several results: a slider through them, in the order they were given."""
    gui = viewer.served.server.gui
    day = gui.add_slider("Result", min=1, max=len(viewer.names), step=1, initial_value=1)
    name = gui.add_html(words.note(viewer.names[0]))

    @day.on_update
    def _(_: object) -> None:
        viewer.load(int(day.value) - 1)
        name.content = words.note(viewer.names[int(day.value) - 1])


def _look(viewer: Viewer) -> None:
    gui = viewer.served.server.gui
    shown = viewer.shown
    for layer in LAYERS:
        if (layer == "truth" and shown.truth_file is None) or (layer in ("canister", "cameras") and shown.dataset is None):
            continue
        box = gui.add_checkbox(_FIRST[layer], initial_value=layer in viewer.look.layers)

        def switch(_: object, layer: str = layer, box: viser.GuiInputHandle[bool] = box) -> None:
            viewer.look.layers ^= {layer} if (layer in viewer.look.layers) != bool(box.value) else set()
            viewer.refresh()

        box.on_update(switch)
    if shown.truth_file is not None:
        compare = gui.add_dropdown("Truth is drawn", TRUTH)

        @compare.on_update
        def _(_: object) -> None:
            viewer.look.truth = str(compare.value)
            viewer.refresh()

    by = gui.add_dropdown("Colour by", colours.CHOICES, initial_value=viewer.look.colour)
    legend = gui.add_html("")
    _clip(viewer)

    @by.on_update
    def _(_: object) -> None:
        viewer.look.colour = str(by.value)
        viewer.refresh()

    def follow() -> None:
        legend.content = words.note(colours.colouring(viewer.look.colour, viewer.shown.session.state.lines)[1])

    viewer.on_change.append(follow)


def _clip(viewer: Viewer) -> None:
    """Make a slider for each direction, which cuts away what lies beyond its ends."""
    gui = viewer.served.server.gui
    centre = viewer.shown.session.measure().solid.centre_mm
    low, high = np.floor(centre.min(axis=0)) - 1.0, np.ceil(centre.max(axis=0)) + 1.0
    sliders = []
    for axis, name in ((2, "Heights shown (mm)"), (0, "x shown (mm)"), (1, "y shown (mm)")):
        ends = float(low[axis]), float(high[axis])
        slider = gui.add_multi_slider(name, min=ends[0], max=ends[1], step=0.1, initial_value=ends)
        sliders.append(slider)

        def cut(_: object, axis: int = axis, slider: viser.GuiMultiSliderHandle[float] = slider, ends: tuple[float, float] = ends) -> None:
            below, above = slider.value
            viewer.cut_away(axis, None if below <= ends[0] else float(below), None if above >= ends[1] else float(above))

        slider.on_update(cut)


def _correct(viewer: Viewer) -> None:
    gui = viewer.served.server.gui
    mode = gui.add_dropdown("A click means", CLICKS)
    undo = gui.add_button_group("History", ("Undo", "Redo", "Save"))
    _edit_buttons(viewer)
    _box(viewer)
    log = gui.add_html("")

    @mode.on_update
    def _(_: object) -> None:
        viewer.look.click = str(mode.value)

    @undo.on_click
    def _(_: object) -> None:
        {"Undo": viewer.undo, "Redo": viewer.redo, "Save": viewer.save}[str(undo.value)]()

    gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda _: viewer.undo())
    gui.add_command("Redo", hotkey="Y", modifier="cmd/ctrl").on_trigger(lambda _: viewer.redo())
    gui.add_command("Save corrections", hotkey="S", modifier="cmd/ctrl").on_trigger(lambda _: viewer.save())

    def follow() -> None:
        session = viewer.shown.session
        count = len(session.log.edits)
        done = f"{count} edit{'' if count == 1 else 's'}: " + "; ".join(edit.do for edit in session.log.edits[-5:])
        log.content = words.note(done if count else "No edits yet.")

    viewer.on_change.append(follow)


def _edit_buttons(viewer: Viewer) -> None:
    """Make a button for each edit of what is chosen."""
    gui = viewer.served.server.gui
    buttons: list[tuple[str, Callable[[], object], str | None, Literal["red"] | None]] = [
        ("Delete", viewer.delete, "take away what is chosen", "red"),
        ("Delete with laterals", lambda: viewer.delete(laterals=True), "take the chosen roots away with all that hangs on them", "red"),
        ("Bring the last one back", viewer.restore, "bring back what was taken away last: a root, roots or voxels", None),
        ("Join two", lambda: viewer.pair("join"), "let the first chosen root go on in the second", None),
        ("Make lateral of the second", lambda: viewer.pair("parent"), "make the first chosen root a lateral of the second", None),
        ("Fit again", viewer.fit_again, "fit centre lines and diameters to the pictures again", None),
        ("Choose nothing", viewer.choose_nothing, None, None),
    ]
    for label, act, hint, colour in buttons:
        button = gui.add_button(label, hint=hint, color=colour)

        def press(_: object, act: Callable[[], object] = act) -> None:
            act()

        button.on_click(press)


def _box(viewer: Viewer) -> None:
    """Make what chooses or deletes all in a box."""
    gui = viewer.served.server.gui
    with gui.add_folder("A box", expand_by_default=False):
        low = gui.add_vector3("From (mm)", initial_value=(-10.0, -10.0, -60.0), step=0.1)
        high = gui.add_vector3("To (mm)", initial_value=(10.0, 10.0, -50.0), step=0.1)
        choose = gui.add_button("Choose its voxels")
        clear = gui.add_button("Delete what lies in it", color="red")

    @choose.on_click
    def _(_: object) -> None:
        viewer.choose_box(low.value, high.value)

    @clear.on_click
    def _(_: object) -> None:
        viewer.do("delete box", box_mm=(tuple(low.value), tuple(high.value)))


def _pictures(viewer: Viewer) -> None:
    gui = viewer.served.server.gui
    pictures = viewer.shown.pictures
    if pictures is None:
        gui.add_html(words.note("The pictures are not here: start rhizotwin view RESULT DATASET."))
        return
    gui.add_html(words.note("The reconstruction is drawn over each picture as the water bends it."))
    step = gui.add_button_group("Picture", ("Previous", "Next", "Back to 3D"))
    name = gui.add_html("")

    @step.on_click
    def _(_: object) -> None:
        here = viewer.standing
        if step.value == "Back to 3D":
            viewer.stand(None)
        else:
            viewer.stand(0 if here is None else here + (1 if step.value == "Next" else -1))

    def follow() -> None:
        now = viewer.shown.pictures
        if viewer.standing is not None and now is not None:
            angle = now.table_deg[viewer.standing]
            name.content = words.note(
                now.files[viewer.standing] + ("" if angle is None else f", table at {round(angle, 1) % 360.0:.1f} degrees")
            )
        else:
            name.content = words.note(f"{0 if now is None else len(now.views)} pictures with cameras")

    viewer.on_change.append(follow)
