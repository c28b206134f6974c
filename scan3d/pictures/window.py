"""A window to turn a scan in: layers to switch, colours to choose, and contacts that say what was felt."""

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
from scan3d.pictures.parts import normal_lines, outlines, shown_sweep
from scan3d.pictures.rendering import renders
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import (
    BODY,
    INK,
    NORMAL,
    ROD,
    TIP,
    Shade,
    shade_contacts,
    shade_surface,
)
from scan3d.pictures.words import contact_sentence

NO_DISPLAY = (
    "there is no display to open a window on; write a picture with --screenshot FILE, or a page with --html FILE"
)
# A click picks the contact nearest to it, if it is nearer than this share of the diagonal.
_NEAR = 0.03
_STATES = 9
# Pixels from line to line, and from the left edge.
_LINE, _LEFT = 34, 14


@functools.cache
def can_open() -> bool:
    """Whether a window can be opened here, tried out in a child process."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    return renders(on_screen=True)


def open_window(scene: Scene, tell: Callable[[str], None], color: str = "force") -> None:
    """Show the scene until the window is closed; `tell` gets the sentence of each contact that is clicked.

    Raises InputError where there is no display.
    """
    if not can_open():
        raise InputError(NO_DISPLAY)
    window(scene, tell, color).plotter.show(title=f"{scene.name} – scan3d")


class Window:
    """A plotter with its layers by name (lists of actors), not shown yet."""

    def __init__(self, plotter: Any, scene: Scene, tell: Callable[[str], None]) -> None:
        self.plotter, self.scene, self.tell = plotter, scene, tell
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
        norm = shaded.norm
        scale = "tangential red, tip orange" if norm is None else f"{norm.vmin:.3g} (dark) to {norm.vmax:.3g} (light)"
        self.plotter.add_text(
            f"{shaded.title}: {scale}", position="lower_right", font_size=11, color=INK, name="colour"
        )
        self.plotter.render()

    def pick(self, point: Any) -> None:
        """Tell of the contact nearest to a clicked point (3,)."""
        away = np.linalg.norm(self.scene.points - np.asarray(point), axis=1)
        if len(away) and away.min() <= _NEAR * self.scene.diagonal:
            self.tell(contact_sentence(self.scene, int(away.argmin())))


def window(scene: Scene, tell: Callable[[str], None], color: str = "force", *, off_screen: bool = False) -> Window:
    """The window with its buttons, to be shown by `plotter.show()`."""
    import pyvista

    canvas = Canvas(scene.corners, off_screen=off_screen)
    made = Window(canvas.plotter, scene, tell)
    if scene.surface is not None:
        mesh, shaded = shade_surface(scene)
        made.layers["surface"] = [canvas.add_body(mesh, BODY if shaded is None else shaded.rgb)]
        if shaded is not None:
            _bar(canvas.plotter, shaded)
    if scene.truth is not None:
        made.layers["truth"] = [canvas.add_body(scene.truth, TIP, opacity=0.4)]
    known = [name for name in COLORS if scene.column(name) is not None]
    if scene.contacts is not None:
        made.contacts = pyvista.PolyData(scene.points)
        made.contacts["rgb"] = np.tile(np.array([178, 24, 43], dtype=np.uint8), (len(scene.points), 1))
        actor = canvas.plotter.add_mesh(
            made.contacts, scalars="rgb", rgb=True, point_size=7, render_points_as_spheres=True
        )
        made.layers["contacts"] = [actor]
        made.layers["normals"] = canvas.add_lines(normal_lines(scene), NORMAL, 1)
        made.layers["slices"] = [a for ring, _ in outlines(scene) for a in canvas.add_lines(ring[None], INK, 1)]
    if scene.recording is not None:
        one = shown_sweep(scene)
        states = np.unique(np.linspace(0, len(one.base) - 1, _STATES).round().astype(int))
        made.layers["rods"] = canvas.add_rods(one, states)
    _buttons(made, known, color if color in known else "")
    canvas.aim(1200, 900)
    canvas.plotter.enable_point_picking(
        lambda point: made.pick(point), show_message=False, left_clicking=True, show_point=False
    )
    return made


def _buttons(made: Window, known: list[str], color: str) -> None:
    """A box for every layer, and a button for every colour of the contacts."""
    plotter, height = made.plotter, _LEFT

    def text(words: str, at: int) -> None:
        plotter.add_text(words, position=(_LEFT + 34, at), font_size=11, color=INK)

    for name in [one for one in COLORS[::-1] if one in known]:
        plotter.add_radio_button_widget(
            functools.partial(made.paint, name), "colour", value=name == color, position=(_LEFT, height), size=24
        )
        text(f"colour: {name}", height)
        height += _LINE
    for name in reversed(list(made.layers)):
        on = name in ("surface", "contacts")
        made.switch(name, on)
        plotter.add_checkbox_button_widget(
            functools.partial(made.switch, name), value=on, position=(_LEFT, height), size=24, color_on=ROD
        )
        text(name, height)
        height += _LINE
    if color:
        made.paint(color)


def _bar(plotter: Any, shaded: Shade) -> None:
    import pyvista

    low, high = shaded.norm.vmin, shaded.norm.vmax
    table = pyvista.LookupTable(shaded.map, scalar_range=(low, high))
    mapper = pyvista.DataSetMapper()
    mapper.lookup_table = table
    plotter.add_scalar_bar(
        shaded.title, mapper=mapper, vertical=True, position_x=0.88, position_y=0.25, width=0.06, height=0.5,
        fmt="%.3g", color=INK, title_font_size=16, label_font_size=14,
    )  # fmt: skip
