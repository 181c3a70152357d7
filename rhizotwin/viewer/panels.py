"""Panels of the viewer: volume, list of results, selection, the tab "Traits", and the picture beside the 3D view."""

from __future__ import annotations

import re

import viser

from rhizotwin.drawing import root_colours
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import edit_tab, view_tab, words
from rhizotwin.viewer.app import Viewer, ray_of, screen_of
from rhizotwin.viewer.drawing import set_value

_PANEL_PX, _PICTURE_PX, _EDGE_PX = 300, 264, 12
"""Widths of the panel and of the window with a picture, and distance of the window from the lower left corner, px. The
3D view keeps three quarters of a screen of 1280 pixels, and the window covers a corner of it."""
_NO_ROOT = "none"


def build(viewer: Viewer) -> None:
    """Build the panel and register the handlers of clicks into the 3D scene."""
    server = viewer.served.server
    gui = server.gui
    gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False, control_width="small")
    gui.main_panel.dock_right()
    gui.main_panel.set_width(_PANEL_PX)
    head = gui.add_html("")
    message = gui.add_html("", visible=False)
    if len(viewer.names) > 1:
        _add_results(viewer)
    _add_selection(viewer)
    tabs = gui.add_tab_group()
    for name, add in (("View", view_tab.add), ("Edit", edit_tab.add), ("Traits", _add_traits)):
        with tabs.add_tab(name):
            add(viewer)
    _add_pictures(viewer)
    gui.add_html(words.note("Press ? for all commands and keys."))

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
    """Add the slider that switches between several results."""
    gui = viewer.served.server.gui
    number = gui.add_slider("Result", min=1, max=len(viewer.names), step=1, initial_value=1)
    name = gui.add_html(words.note(viewer.names[0]))

    @number.on_update
    def _(_: object) -> None:
        if int(number.value) - 1 == viewer.place:
            return
        try:
            viewer.load(int(number.value) - 1)
        except UserError as error:
            viewer.notify(str(error))
            set_value(number, viewer.place + 1)
        name.content = words.note(viewer.names[viewer.place])


def _add_selection(viewer: Viewer) -> None:
    """Add the list of roots, and the description of the selection."""
    gui = viewer.served.server.gui
    roots = gui.add_dropdown("Root", (_NO_ROOT,), hint="select a root from the list, or click it in the 3D view or in a picture")
    selection = gui.add_html("")
    root = gui.add_html("", visible=False)

    @roots.on_update
    def _(_: object) -> None:
        picked = re.match(r"root (\d+)", str(roots.value))
        if picked and viewer.roots != [int(picked[1])]:
            viewer.select_root(int(picked[1]))
        elif not picked and viewer.roots:
            viewer.deselect()

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
            set_value(roots, shown)
        volumes = session.measure().volumes_mm3
        selected_mm3 = float(sum(volumes[row] for row in viewer.voxels))
        is_root = len(there) == 1 and not viewer.voxels  # described below
        length_mm = sum(lines[k].length_mm for k in there)
        text = "" if is_root else words.selection(len(there), length_mm, len(viewer.voxels), selected_mm3)
        if len(viewer.measured) == 2:
            a, b = viewer.measured
            text += words.note(f"Distance: {float(((a - b) ** 2).sum()) ** 0.5:.2f} mm")
        selection.content, selection.visible = text, bool(text)
        root.visible = len(there) == 1
        if root.visible:
            root.content = words.root(there[0], lines, orders[there[0]])

    viewer.on_change.append(follow)


def _add_pictures(viewer: Viewer) -> None:
    """Add the panel with a picture beside the 3D view, and the buttons that switch between the pictures."""
    gui = viewer.served.server.gui
    missing = gui.add_html(words.note("The dataset was not found. Restart the viewer with 'rhizotwin view RESULT DATASET'."))
    panel = gui.add_panel()
    with panel.add_tab("Picture", viser.Icon.PHOTO):
        image = gui.add_html(words.note("Drawing the outline ..."))
        gui.add_button("Previous", icon=viser.Icon.CHEVRON_LEFT).on_click(lambda _: viewer.step_picture(-1))
        gui.add_button("Next", icon=viser.Icon.CHEVRON_RIGHT).on_click(lambda _: viewer.step_picture(1))
        enter = gui.add_button("Its camera", icon=viser.Icon.CAMERA)
        back = gui.add_button("Back to 3D", icon=viser.Icon.CUBE)
    panel.float(x=_EDGE_PX, y=-_EDGE_PX, width=_PICTURE_PX)
    enter.on_click(lambda _: viewer.enter_picture(viewer.beside))
    back.on_click(lambda _: viewer.enter_picture(None))

    def show(jpeg: bytes) -> None:
        pictures, place = viewer.shown.pictures, viewer.beside
        if pictures is not None:
            image.content = words.picture(pictures.files[place], jpeg, pictures.table_deg[place])

    def follow() -> None:
        there = viewer.shown.pictures is not None
        panel.visible, missing.visible = there, not there
        enter.disabled, back.disabled = viewer.picture is not None, viewer.picture is None

    viewer.on_beside.append(show)
    viewer.on_change.append(follow)


def _add_traits(viewer: Viewer) -> None:
    """Add the table of traits of the corrected result."""
    table = viewer.served.server.gui.add_html(words.note("Measuring ..."))

    def follow() -> None:
        session = viewer.shown.session
        table.content = words.traits(viewer.shown.traits(), edited=bool(session.log.edits), summary=session.summary)

    viewer.on_measured.append(follow)
