"""Panel tab "View": preset views, layers, colours, screenshot, movie and clipping."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import viser

from rhizotwin.drawing import root_colours
from rhizotwin.viewer import capture, words
from rhizotwin.viewer.app import Viewer
from rhizotwin.viewer.drawing import set_value
from rhizotwin.viewer.look import LAYERS, TRUTH
from rhizotwin.viewer.scene3d import VIEWS

_LABELS = {
    "surface": "Surface",
    "centre lines": "Centre lines",
    "tubes": "Tubes",
    "voxels": "Voxels",
    "canister": "Canister",
    "cameras": "Cameras",
    "truth": "True shape",
    "scale bar": "Scale bar",
}
_AXES = ((2, "Height (mm)"), (0, "x (mm)"), (1, "y (mm)"))


def add(viewer: Viewer) -> None:
    """Add preset views, layers, colours, screenshot, movie and clipping."""
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
    """Add a checkbox for each layer, which is visible if the displayed result has the layer."""
    gui = viewer.served.server.gui
    boxes: dict[str, viser.GuiCheckboxHandle] = {}
    for layer in LAYERS:
        box = boxes[layer] = gui.add_checkbox(_LABELS[layer], initial_value=layer in viewer.look.layers)

        def switch(_: object, layer: str = layer, box: viser.GuiInputHandle[bool] = box) -> None:
            if (layer in viewer.look.layers) != bool(box.value):
                viewer.look.layers ^= {layer}
                viewer.refresh()

        box.on_update(switch)
    compare = gui.add_dropdown("True shape is", TRUTH)

    @compare.on_update
    def _(_: object) -> None:
        viewer.look.truth = str(compare.value)
        viewer.refresh()

    def follow() -> None:
        shown = viewer.shown
        there = {"truth": shown.truth_file is not None, **dict.fromkeys(("canister", "cameras"), shown.dataset is not None)}
        for layer, box in boxes.items():
            box.visible = there.get(layer, True)
            if box.value != (layer in viewer.look.layers):
                set_value(box, layer in viewer.look.layers)
        compare.visible = there["truth"] and "truth" in viewer.look.layers

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
    gui = viewer.served.server.gui
    picture = gui.add_button("Screenshot (PNG)", icon=viser.Icon.CAMERA)
    movie = gui.add_button("Turntable (GIF)", icon=viser.Icon.MOVIE)
    bar = gui.add_progress_bar(0.0, visible=False)
    recording = threading.Lock()

    def save(client: viser.ClientHandle | None, ending: str, make: Callable[[viser.ClientHandle], bytes]) -> None:
        if client is None or not recording.acquire(blocking=False):
            return
        picture.disabled = movie.disabled = True
        try:
            client.send_file_download(f"{viewer.shown.name}_{ending}", make(client), save_immediately=True)
        except (TimeoutError, RuntimeError) as error:
            viewer.notify(f"the browser could not render the picture ({error}); keep the browser window visible and try again")
        finally:
            picture.disabled = movie.disabled = bar.visible = False
            recording.release()

    def record(client: viser.ClientHandle) -> bytes:
        set_value(bar, 0.0)
        bar.visible = True

        def progress(share: float) -> None:
            set_value(bar, 100.0 * share)

        return capture.turntable(client, progress=progress)

    picture.on_click(lambda event: save(event.client, "view.png", capture.screenshot))
    movie.on_click(lambda event: save(event.client, "turntable.gif", record))


def _add_clipping(viewer: Viewer) -> None:
    """Add a slider for each axis, which clips the display to a range of coordinates."""
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
