"""A window in which a scan can be turned, layers switched, colours chosen, and contacts clicked for what was measured."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.parts import evenly_chosen, has_rods, normal_lines, sections, shown_sweep
from scan3d.pictures.rendering import renders
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import (
    BODY,
    INK,
    NORMAL,
    ROD,
    TANGENTIAL,
    TIP,
    Shade,
    shade_contacts,
    shade_surface,
)
from scan3d.pictures.words import contact_sentence

NO_DISPLAY = (
    "there is no display to open a window on; write a picture with --screenshot FILE, or a page with --html FILE"
)
# A click picks the contact nearest to it, if it is nearer than this fraction of the diagonal: a click beside a contact still
# picks it, and a click on a bare part of the body does not.
_NEAR = 0.03
# Rods drawn along a sweep: more than in a picture, as the window can be enlarged.
_STATES = 9
# Pixels from button to button, from the left edge, of a button, and points of its label.
_LINE, _LEFT, _BUTTON, _FONT = 34, 14, 24, 11
# Diameter of a contact in pixels, as in pictures.
_CONTACT_SIZE = 7
# Opacity of the truth: the surface is seen through it.
_TRUTH_OPACITY = 0.4


@functools.cache
def can_open() -> bool:
    """Whether a window can be opened here, tried in a child process once."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    return renders(on_screen=True)


def open_window(scene: Scene, on_pick: Callable[[str], None], color: str = "force") -> None:
    """Show the scene until the window is closed; `on_pick` gets the sentence of each contact that is clicked.

    Raises InputError where there is no display.
    """
    if not can_open():
        raise InputError(NO_DISPLAY)
    build_window(scene, on_pick, color).plotter.show(title=f"{scene.name} – scan3d")


class Window:
    """A plotter that is not shown yet, and its layers, lists of actors, by name."""

    def __init__(self, plotter: Any, scene: Scene, on_pick: Callable[[str], None]) -> None:
        self.plotter, self.scene, self.on_pick = plotter, scene, on_pick
        self.layers: dict[str, list[Any]] = {}
        self.contacts: Any = None

    def switch(self, name: str, on: bool) -> None:
        """Show or hide a layer."""
        for actor in self.layers[name]:
            actor.SetVisibility(bool(on))
        self.plotter.render()

    def paint(self, color: str) -> None:
        """Colour the contacts by one of `COLORS`."""
        shaded = shade_contacts(self.scene, color)
        self.contacts["rgb"] = shaded.rgb
        norm, (low, high) = shaded.norm, ("blue", "red") if color == "bending" else ("dark", "light")
        scale = "tangential red, tip orange" if norm is None else f"{norm.vmin:.3g} ({low}) to {norm.vmax:.3g} ({high})"
        self.plotter.add_text(
            f"{shaded.title}: {scale}", position="lower_right", font_size=_FONT, color=INK, name="colour"
        )
        self.plotter.render()

    def pick(self, point: Any) -> None:
        """Call `on_pick` for the contact nearest to a clicked point (3,), if one is near."""
        distance = np.linalg.norm(self.scene.points - np.asarray(point), axis=1)
        if len(distance) and distance.min() <= _NEAR * self.scene.diagonal:
            self.on_pick(contact_sentence(self.scene, int(distance.argmin())))


def build_window(
    scene: Scene, on_pick: Callable[[str], None], color: str = "force", *, off_screen: bool = False
) -> Window:
    """A window with its buttons; its `plotter.show()` opens it."""
    import pyvista

    canvas = Canvas(scene.corners, off_screen=off_screen)
    window = Window(canvas.plotter, scene, on_pick)
    if scene.surface is not None:
        mesh, shaded = shade_surface(scene)
        window.layers["surface"] = [canvas.add_body(mesh, BODY if shaded is None else shaded.rgb)]
        if shaded is not None:
            _color_bar(canvas.plotter, shaded)
    if scene.truth is not None:
        window.layers[scene.reference] = [canvas.add_body(scene.truth, TIP, opacity=_TRUTH_OPACITY)]
    known = [name for name in COLORS if scene.column(name) is not None]
    if scene.contacts is not None:
        window.contacts = pyvista.PolyData(scene.points)
        window.contacts["rgb"] = np.tile(
            np.array(pyvista.Color(TANGENTIAL).int_rgb, dtype=np.uint8), (len(scene.points), 1)
        )
        actor = canvas.plotter.add_mesh(
            window.contacts, scalars="rgb", rgb=True, point_size=_CONTACT_SIZE, render_points_as_spheres=True
        )
        window.layers["contacts"] = [actor]
        window.layers["normals"] = canvas.add_lines(normal_lines(scene), NORMAL, 1)
        name, lines = sections(scene)
        window.layers[name] = [actor for line, _ in lines for actor in canvas.add_lines(line[None], INK, 1)]
    if has_rods(scene):
        sweep = shown_sweep(scene)
        window.layers["rods"] = canvas.add_rods(sweep, evenly_chosen(len(sweep.base), _STATES))
    _buttons(window, known, color if color in known else "")
    canvas.plotter.window_size = [1200, 900]  # fits on the screens of laptops
    canvas.aim(1200, 900)
    canvas.plotter.enable_point_picking(
        lambda point: window.pick(point), show_message=False, left_clicking=True, show_point=False
    )
    return window


def _buttons(window: Window, known: list[str], color: str) -> None:
    """Add a box for every layer, and a button for every known colour of the contacts."""
    plotter, height = window.plotter, _LEFT

    def label(text: str, bottom: int) -> None:
        plotter.add_text(text, position=(_LEFT + _LINE, bottom), font_size=_FONT, color=INK)

    for name in [name for name in COLORS[::-1] if name in known]:
        plotter.add_radio_button_widget(
            functools.partial(window.paint, name), "colour", value=name == color, position=(_LEFT, height), size=_BUTTON
        )
        label(f"colour: {name}", height)
        height += _LINE
    for name in reversed(list(window.layers)):
        on = name in ("surface", "contacts")
        window.switch(name, on)
        plotter.add_checkbox_button_widget(
            functools.partial(window.switch, name), value=on, position=(_LEFT, height), size=_BUTTON, color_on=ROD
        )
        label(name, height)
        height += _LINE
    if color:
        window.paint(color)


def _color_bar(plotter: Any, shaded: Shade) -> None:
    import pyvista

    low, high = shaded.norm.vmin, shaded.norm.vmax
    table = pyvista.LookupTable(shaded.map, scalar_range=(low, high))
    mapper = pyvista.DataSetMapper()
    mapper.lookup_table = table
    plotter.add_scalar_bar(
        shaded.title, mapper=mapper, vertical=True, position_x=0.88, position_y=0.25, width=0.06, height=0.5,
        fmt="%.3g", color=INK, title_font_size=16, label_font_size=14,
    )  # fmt: skip
