"""The panel beside the 3D view: buttons, sliders and what they say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import viser

from rhizotwin.viewer import colours, words
from rhizotwin.viewer.app import Viewer, ray_of, screen_of
from rhizotwin.viewer.drawing import CLICKS, LAYERS, TRUTH

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
    if len(viewer.names) > 1:
        _days(viewer)
    tabs = gui.add_tab_group()
    with tabs.add_tab("Look"):
        _look(viewer)
    with tabs.add_tab("Correct"):
        _correct(viewer)
    with tabs.add_tab("Pictures"):
        _pictures(viewer)

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
    height = shown.session.measure().solid.centre_mm[:, 2]
    low, high = float(height.min()) - 1.0, float(height.max()) + 1.0
    ends = round(low, 1), round(high, 1)
    clip = gui.add_multi_slider("Heights shown (mm)", min=ends[0], max=ends[1], step=0.1, initial_value=ends)

    @by.on_update
    def _(_: object) -> None:
        viewer.look.colour = str(by.value)
        viewer.refresh()

    @clip.on_update
    def _(_: object) -> None:
        bottom, top = clip.value
        viewer.look.low_mm = -1e9 if bottom <= low + 0.1 else float(bottom)
        viewer.look.high_mm = 1e9 if top >= high - 0.1 else float(top)
        viewer.refresh()

    def follow() -> None:
        legend.content = words.note(colours.colouring(viewer.look.colour, viewer.shown.session.state.lines)[1])

    viewer.on_change.append(follow)


def _correct(viewer: Viewer) -> None:
    gui = viewer.served.server.gui
    mode = gui.add_dropdown("A click means", CLICKS)
    chosen = gui.add_html("")
    root = gui.add_html("", visible=False)
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
        lines = session.state.lines
        there = [k for k in viewer.roots if k in lines]
        volumes = session.measure().volumes_mm3
        taken = float(sum(volumes[row] for row in viewer.voxels))
        chosen.content = words.chosen(len(there), sum(lines[k].length_mm for k in there), len(viewer.voxels), taken)
        if len(viewer.measured) == 2:
            a, b = viewer.measured
            chosen.content += words.note(f"{float(((a - b) ** 2).sum()) ** 0.5:.2f} mm between the two points")
        root.visible = len(there) == 1
        if len(there) == 1:
            number = there[0]
            pictures = viewer.shown.pictures
            best = [] if pictures is None else [pictures.files[k] for k in pictures.best_for(lines[number])]
            root.content = words.root(number, lines, colours.order_of(lines)[number], best) + words.profile(lines[number])
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
        ("Bring the last one back", viewer.restore, "bring the root back that was taken away last", None),
        ("Join two", lambda: viewer.pair("join"), "let the first chosen root go on in the second", None),
        ("Hang on the second", lambda: viewer.pair("parent"), "make the first chosen root a lateral of the second", None),
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
