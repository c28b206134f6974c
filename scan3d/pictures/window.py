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
from scan3d.pictures.canvas import CONTACT_SIZE, Canvas
from scan3d.pictures.parts import evenly_chosen, has_rods, normal_lines, sections, shown_sweep
from scan3d.pictures.rendering import renders
from scan3d.pictures.scene import Scene, contact_sentence
from scan3d.pictures.shading import BODY, INK, NORMAL, ROD, TANGENTIAL, TIP, Shade, shade_contacts, shade_surface

NO_DISPLAY = (
    "there is no display to open a window on; write a picture with --screenshot FILE, or a page with --html FILE"
)
# Pixels of a window, which fits on the screens of laptops.
_SIZE = (1200, 900)
# Points of letters, by which buttons are measured in pixels: their size, and from button to button.
_FONT = 11
_BUTTON, _LINE = 2 * _FONT, 3 * _FONT


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
    Window(scene, on_pick, color).plotter.show(title=f"{scene.name} – scan3d")


class Window:
    """A window with its buttons, which `plotter.show()` opens, and its layers, lists of actors, by name."""

    def __init__(
        self, scene: Scene, on_pick: Callable[[str], None], color: str = "force", *, off_screen: bool = False
    ) -> None:
        import pyvista

        scene = scene.in_shown_unit()
        canvas = Canvas(scene.corners, off_screen=off_screen)
        canvas.plotter.window_size = [*_SIZE]
        self.plotter, self.scene, self.on_pick = canvas.plotter, scene, on_pick
        self.layers: dict[str, list[Any]] = {}
        if scene.surface is not None:
            mesh, shaded = shade_surface(scene)
            self.layers["surface"] = [canvas.add_body(mesh, BODY if shaded is None else shaded.rgb)]
            if shaded is not None:
                _color_bar(canvas.plotter, shaded)
        if scene.truth is not None:
            self.layers[scene.reference] = [canvas.add_body(scene.truth, TIP, opacity=0.4)]
        if scene.contacts is not None:
            self.contacts = pyvista.PolyData(scene.points)
            plain = np.array(pyvista.Color(TANGENTIAL).int_rgb, dtype=np.uint8)
            self.contacts["rgb"] = np.tile(plain, (len(scene.points), 1))
            actor = canvas.plotter.add_mesh(
                self.contacts, scalars="rgb", rgb=True, point_size=CONTACT_SIZE, render_points_as_spheres=True
            )
            self.layers["contacts"] = [actor]
            self.layers["normals"] = canvas.add_lines(normal_lines(scene), NORMAL, 1)
            name, lines = sections(scene)
            self.layers[name] = [actor for line, _ in lines for actor in canvas.add_lines(line[None], INK, 1)]
        if has_rods(scene):
            sweep = shown_sweep(scene)
            self.layers["rods"] = canvas.add_rods(sweep, evenly_chosen(len(sweep.base), 9))
        self._add_buttons(color)
        canvas.aim(*_SIZE)
        canvas.plotter.enable_point_picking(self.pick, show_message=False, left_clicking=True, show_point=False)

    def _add_buttons(self, color: str) -> None:
        """Add a box for every layer, and a button for every known colour of the contacts."""
        plotter, bottom = self.plotter, _FONT
        known = [name for name in COLORS if self.scene.column(name) is not None]
        for name in reversed(known):
            paint = functools.partial(self.paint, name)
            place = (_FONT, bottom)
            plotter.add_radio_button_widget(paint, "colour", value=name == color, position=place, size=_BUTTON)
            bottom = self._add_label(f"colour: {name}", bottom)
        for name in reversed(self.layers):
            on, switch = name in ("surface", "contacts"), functools.partial(self.switch, name)
            self.switch(name, on)
            place = (_FONT, bottom)
            plotter.add_checkbox_button_widget(switch, value=on, position=place, size=_BUTTON, color_on=ROD)
            bottom = self._add_label(name, bottom)
        if color in known:
            self.paint(color)

    def _add_label(self, text: str, bottom: int) -> int:
        """Write the label of a button; the place of the next one."""
        self.plotter.add_text(text, position=(_FONT + _LINE, bottom), font_size=_FONT, color=INK)
        return bottom + _LINE

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
        """Call `on_pick` for the contact nearest to a clicked point (3,), if one is near; also for a click beside it."""
        distance = np.linalg.norm(self.scene.points - np.asarray(point), axis=1)
        if len(distance) and distance.min() <= 0.03 * self.scene.diagonal:
            self.on_pick(contact_sentence(self.scene, int(distance.argmin())))


def _color_bar(plotter: Any, shaded: Shade) -> None:
    import pyvista

    mapper = pyvista.DataSetMapper()
    mapper.lookup_table = pyvista.LookupTable(shaded.map, scalar_range=(shaded.norm.vmin, shaded.norm.vmax))
    plotter.add_scalar_bar(
        shaded.title, mapper=mapper, vertical=True, position_x=0.88, position_y=0.25, width=0.06, height=0.5,
        fmt="%.3g", color=INK, title_font_size=16, label_font_size=14,
    )  # fmt: skip
