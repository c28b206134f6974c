"""What VTK renders, and whether it can do so on this machine, off screen or in a window.

A three-dimensional canvas: bodies, points, tubes and lines before a camera in parallel projection, and a window.

In the window a scan can be turned, layers switched, colours chosen, and contacts clicked for what was measured.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, evenly
from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.pictures import parts
from scan3d.pictures.parts import DIRECTION, Scene, contact_sentence
from scan3d.workers import python

# Without X and EGL, VTK ends the process that renders: a child process tries first, by drawing a sphere on a black image.
# Where a display does not answer, VTK falls back to a window that is never shown.
_PROBE = """
import sys
from vtkmodules.vtkFiltersSources import vtkSphereSource
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter
import vtkmodules.vtkRenderingOpenGL2
sphere, mapper, actor, renderer, window = vtkSphereSource(), vtkPolyDataMapper(), vtkActor(), vtkRenderer(), vtkRenderWindow()
mapper.SetInputConnection(sphere.GetOutputPort())
actor.SetMapper(mapper)
renderer.AddActor(actor)
window.SetOffScreenRendering(sys.argv[1] == "off screen")
if sys.argv[1] == "on screen" and not window.GetShowWindow():
    sys.exit(3)
window.SetSize(32, 32)
window.AddRenderer(renderer)
window.Render()
image = vtkWindowToImageFilter()
image.SetInput(window)
image.ReadFrontBufferOff()
image.Update()
low, high = image.GetOutput().GetScalarRange()
sys.exit(0 if high > low else 3)
"""
NO_RENDERER = (
    "no pictures: nothing here can render off screen; on Debian or Ubuntu install it with "
    "'apt-get install libegl1 libgl1', then run again"
)
WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
"""The environment variable that names the class of VTK's windows."""
_is_known: bool | None = None


class NoRendererError(InputError):
    """Nothing can be rendered on this machine."""


def can_render(trial: Callable[[], bool] | None = None) -> bool:
    """Whether VTK can render off screen on this machine, which is tried once, by a child process that ends or by the trial."""
    global _is_known
    if _is_known is None:
        trial = trial or renders
        if sys.platform == "linux" and not os.environ.get("DISPLAY") and WINDOW not in os.environ:
            # by default VTK tries X first, and prints warnings without a display
            os.environ[WINDOW] = "vtkEGLRenderWindow"
            try:
                _is_known = trial() or None
            finally:
                if not _is_known:
                    del os.environ[WINDOW]
        _is_known = _is_known or trial()
    return _is_known


def renders(*, on_screen: bool = False) -> bool:
    """Whether a child process can render, on screen or off."""
    target = "on screen" if on_screen else "off screen"
    try:
        # in a separate session: Ctrl-C in the terminal would end the child, which would look like a failure to render
        done = subprocess.run(
            python(_PROBE, target),
            capture_output=True,
            # a busy machine may take as long to import VTK; a display that accepts the connection may never answer
            timeout=20 if on_screen else 120,
            check=False,
            start_new_session=True,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def assume_renderer() -> None:
    """Let `can_render` try nothing, in a process that has been started to render."""
    global _is_known
    _is_known = True


def need_renderer(trial: Callable[[], bool] | None = None) -> None:
    """Raises NoRendererError where `can_render` is false."""
    if not can_render(trial):
        raise NoRendererError(NO_RENDERER)


# Diameter of a contact in pixels: neighbours in a slice merge, contacts of neighbouring slices do not.
CONTACT_SIZE = 7
# Edges are moved toward the camera by this fraction of the size, lines by twice as much, and the body behind contacts away from
# it by three times, so that the faces they lie in do not hide them.
_LAYER = 1e-3


class Canvas:
    """Bodies, points and lines before a camera in parallel projection, whose image contains the given corners (k, 3)."""

    def __init__(
        self,
        corners: Array,
        direction: Any = DIRECTION,
        up: Any = (0.0, 0.0, 1.0),
        *,
        off_screen: bool = True,
        scale: float = 1.0,
        sampling: int = 2,
    ) -> None:
        """`scale` are the pixels that points and lines of one pixel have; an image is rendered `sampling` times larger.

        Averaged from the larger image, edges are smooth on any renderer.
        """
        import pyvista

        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=[64, 64])
        self.sampling = sampling if off_screen else 1
        self.pixel = self.sampling * scale
        self.plotter.set_background("white")
        self.plotter.suppress_rendering = off_screen  # until `image` is called
        if off_screen:
            self.plotter.render_window.SetMultiSamples(0)  # the larger image replaces it
        extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
        if extent <= 1e-12 * np.abs(corners).max():
            corners, extent = corners[:1], 1.0  # a single point, but for rounding: any size will do
        self.corners, self.size = corners, extent
        toward = np.asarray(direction, dtype=float)
        self.toward = toward / np.linalg.norm(toward)
        right = np.cross(np.asarray(up, dtype=float), self.toward)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.toward, self.right)

    def add_body(self, mesh: Any, color: Any, *, edges: Any = None, ambient: float = 0.45, opacity: float = 1.0) -> Any:
        """Add a mesh in one colour, or one (v, 3) for each vertex, and the sharp edges of `edges`.  Returns its actor."""
        import pyvista

        shape = pyvista.wrap(mesh)
        light = dict(ambient=ambient, diffuse=1 - ambient, specular=0.0, opacity=opacity)
        actor = self._add(shape, color, **light)
        sharp = mesh if edges is None else edges
        if "known" in getattr(sharp, "vertex_attributes", ()):  # between contacts and free space facets are rough
            return actor
        # those of polyhedra, not the facets of smooth bodies
        sharp = pyvista.wrap(sharp).extract_feature_edges(
            30.0, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
        )
        if sharp.n_cells and opacity == 1:
            sharp.points = sharp.points + _LAYER * self.size * self.toward
            self.plotter.add_mesh(sharp, color=parts.EDGE, line_width=self._line_width(1))
        return actor

    def _add(self, shape: Any, color: Any, **options: Any) -> Any:
        """Add a shape in one colour, or in one (n, 3) for each of its points.  Returns its actor."""
        if isinstance(color, str):
            return self.plotter.add_mesh(shape, color=color, **options)
        shape.point_data["rgb"] = color
        return self.plotter.add_mesh(shape, scalars="rgb", rgb=True, **options)

    def add_backdrop(self, scene: Scene) -> None:
        """Add a pale body inside the contacts, which hides the contacts behind it."""
        body = scene.surface
        if body is None:
            try:
                body = hull(scene.points)
            except InputError:  # contacts in a plane hide nothing
                return
        body = body.copy()
        body.vertices = body.vertices - 3 * _LAYER * self.size * self.toward
        self.add_body(body, parts.BACKDROP, ambient=0.6)

    def add_points(self, points: Array, color: Any, size: float = CONTACT_SIZE) -> Any:
        """Add points (n, 3) as balls of `size` pixels, in one colour or in one (n, 3) for each.  Returns their actor."""
        import pyvista

        balls = dict(point_size=size * self.pixel, render_points_as_spheres=True, ambient=0.6, diffuse=0.4)
        return self._add(pyvista.PolyData(np.asarray(points)), color, **balls)

    def add_lines(self, lines: Array, color: str, width: float) -> list[Any]:
        """Add lines (k, p, 3), `width` pixels wide.  Returns their actors."""
        import pyvista

        k, p = lines.shape[:2]
        if not k:
            return []
        cells = np.column_stack([np.full(k, p), np.arange(k * p).reshape(k, p)])
        shape = pyvista.PolyData(lines.reshape(-1, 3) + 2 * _LAYER * self.size * self.toward, lines=cells.ravel())
        return [self.plotter.add_mesh(shape, color=color, line_width=self._line_width(width), lighting=False)]

    def _line_width(self, width: float) -> float:
        return max(width * self.pixel, 1.0)  # thinner lines would have gaps

    def add_tube(self, line: Array, color: str, radius: float) -> Any:
        """Add a line (p, 3) as a tube; the radius is a fraction of the size.  Returns its actor."""
        import pyvista

        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        distinct = line[np.insert(step > 1e-6 * self.size, 0, True)]  # between equal points a tube has no direction
        tube = pyvista.lines_from_points(distinct).tube(radius=radius * self.size, n_sides=12, capping=True)
        return self.plotter.add_mesh(tube, color=color)

    def add_rods(self, sweep: parts.ShownSweep, states: NDArray[np.integer], forward: float = 0.0) -> list[Any]:
        """Add the rods of some samples of a sweep with their clamps and contacts.  Returns their actors.

        Contacts are moved toward the camera by `forward`, a fraction of the size.
        """
        import pyvista

        actors, rods, radius = [], sweep.rods, 0.003
        mark = 2 * radius * self.size  # by which clamps and contacts are measured
        for k in states:
            actors.append(self.add_tube(rods[k], parts.ROD, radius))
            clamp = pyvista.Cube(x_length=3 * mark, y_length=3 * mark, z_length=3 * mark)
            center = sweep.base[k] - 1.5 * mark * sweep.turns[k, 1]  # the rod begins at the clamp's face
            clamp.points = center + clamp.points @ sweep.turns[k]
            actors.append(self.plotter.add_mesh(clamp, color=parts.INK))
            ball = pyvista.Sphere(radius=1.7 * mark, center=sweep.contact[k] + forward * self.size * self.toward)
            actors.append(self.plotter.add_mesh(ball, color=parts.TANGENTIAL))
        return actors

    def add_arrow(self, line: Array) -> None:
        """Add a line (2, 3) with a head at its end."""
        import pyvista

        self.add_lines(line[None], parts.INK, 2)
        head = 0.05 * self.size
        cone = pyvista.Cone(center=line[1], direction=line[1] - line[0], height=head, radius=0.28 * head, resolution=24)
        self.plotter.add_mesh(cone, color=parts.INK)

    def aim(self, width: int, height: int, zoom: float = 1.0) -> float:
        """Point the camera so that the corners fill an image of so many pixels, or are `zoom` times larger.

        Returns the width of the image as a length in the world.
        """
        projected = self.corners @ np.stack([self.right, self.up], axis=1)
        low, high = projected.min(axis=0), projected.max(axis=0)
        middle = (low + high) / 2
        depth = self.corners @ self.toward
        # pixels to the unit of length; a margin is left for the size of points and lines
        unit = zoom * float((0.94 * np.array([width, height]) / np.where(high > low, high - low, 1.0)).min())
        center = middle[0] * self.right + middle[1] * self.up + depth.mean() * self.toward
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point = center
        camera.position = center + 3 * self.size * self.toward  # outside of any body
        camera.up = self.up
        camera.parallel_scale = height / 2 / unit
        self.plotter.renderer.ResetCameraClippingRange()
        return float(width / unit)

    def image(self, width: int, height: int, zoom: float = 1.0) -> tuple[NDArray[np.uint8], float]:
        """What the camera sees, (height, width, 3), and the width of the image as a length in the world."""
        from PIL import Image

        across = self.aim(width, height, zoom)
        size = [width * self.sampling, height * self.sampling]
        if list(self.plotter.window_size) != size:
            self.plotter.window_size = size
        self.plotter.suppress_rendering = False
        self.plotter.render()
        large = Image.fromarray(self.plotter.screenshot(return_img=True)[:, :, :3])
        self.plotter.suppress_rendering = True
        return np.asarray(large.reduce(self.sampling)), across


# Points of letters, by which buttons are measured in pixels.
_FONT = 11


NO_DISPLAY = (
    "there is no display to open a window on; write a picture with --screenshot FILE, or a page with --html FILE"
)


@functools.cache
def can_open() -> bool:
    """Whether a window can be opened here, tried in a child process once."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    return renders(on_screen=True)


def need_display() -> None:
    """Raise InputError where there is no display."""
    if not can_open():
        raise InputError(NO_DISPLAY)


class Window:
    """A window with its buttons, which `plotter.show()` opens, and its layers, lists of actors, by name."""

    def __init__(
        self, scene: Scene, on_pick: Callable[[str], None], color: str = "force", *, off_screen: bool = False
    ) -> None:
        import pyvista

        scene = scene.in_shown_unit()
        canvas, size = Canvas(scene.corners, off_screen=off_screen), (1200, 900)  # fits on the screens of laptops
        canvas.plotter.window_size = [*size]
        self.plotter, self.scene, self.on_pick = canvas.plotter, scene, on_pick
        self.layers: dict[str, list[Any]] = {}
        if scene.surface is not None:
            mesh, shaded = parts.shade_surface(scene)
            self.layers["surface"] = [canvas.add_body(mesh, parts.BODY if shaded is None else shaded.rgb)]
            if shaded is not None:
                _color_bar(canvas.plotter, shaded)
        if scene.truth is not None:
            self.layers[scene.reference] = [canvas.add_body(scene.truth, parts.TIP, opacity=0.4)]
        if scene.contacts is not None:
            self.contacts = pyvista.PolyData(scene.points)
            plain = np.array(pyvista.Color(parts.TANGENTIAL).int_rgb, dtype=np.uint8)
            self.contacts["rgb"] = np.tile(plain, (len(scene.points), 1))
            actor = canvas.plotter.add_mesh(
                self.contacts, scalars="rgb", rgb=True, point_size=CONTACT_SIZE, render_points_as_spheres=True
            )
            self.layers["contacts"] = [actor]
            self.layers["normals"] = canvas.add_lines(parts.normal_lines(scene), parts.NORMAL, 1)
            name, lines = parts.sections(scene)
            self.layers[name] = [actor for line, _ in lines for actor in canvas.add_lines(line[None], parts.INK, 1)]
        if parts.has_rods(scene):
            sweep = parts.shown_sweep(scene)
            self.layers["rods"] = canvas.add_rods(sweep, evenly(np.arange(len(sweep.base)), 9))
        self._add_buttons(color)
        canvas.aim(*size, 0.8)  # between the buttons and the bar
        canvas.plotter.enable_point_picking(self.pick, show_message=False, left_clicking=True, show_point=False)

    def _add_buttons(self, color: str) -> None:
        """Add a box for every layer, and a button for every known colour of the contacts."""
        plotter, bottom = self.plotter, _FONT
        known = [name for name in COLORS if self.scene.column(name) is not None]
        for name in reversed(known):
            paint = functools.partial(self.paint, name)
            place = (_FONT, bottom)
            plotter.add_radio_button_widget(paint, "colour", value=name == color, position=place, size=2 * _FONT)
            bottom = self._add_label(f"colour: {name}", bottom)
        for name in reversed(self.layers):
            on, switch = name in ("surface", "contacts"), functools.partial(self.switch, name)
            self.switch(name, on)
            place = (_FONT, bottom)
            plotter.add_checkbox_button_widget(switch, value=on, position=place, size=2 * _FONT, color_on=parts.ROD)
            bottom = self._add_label(name, bottom)
        if color in known:
            self.paint(color)

    def _add_label(self, text: str, bottom: int) -> int:
        """Write the label of a button; the place of the next one."""
        self.plotter.add_text(text, position=(4 * _FONT, bottom), font_size=_FONT, color=parts.INK)
        return bottom + 3 * _FONT

    def switch(self, name: str, on: bool) -> None:
        """Show or hide a layer."""
        for actor in self.layers[name]:
            actor.SetVisibility(bool(on))
        self.plotter.render()

    def paint(self, color: str) -> None:
        """Colour the contacts by one of `COLORS`."""
        shaded = parts.shade_contacts(self.scene, color, parts.ON_DEVIATION)
        self.contacts["rgb"] = shaded.rgb
        norm, (low, high) = shaded.norm, ("blue", "red") if color == "bending" else ("dark", "light")
        scale = "tangential black, tip yellow"
        if norm is not None:
            scale = f"{norm.vmin:.3g} ({low}) to {norm.vmax:.3g} ({high})"
        self.plotter.add_text(
            f"{shaded.title}: {scale}", position="lower_right", font_size=_FONT, color=parts.INK, name="colour"
        )
        self.plotter.render()

    def pick(self, point: Any) -> None:
        """Call `on_pick` for the contact nearest to a clicked point (3,), if one is near; also for a click beside it."""
        distance = np.linalg.norm(self.scene.points - np.asarray(point), axis=1)
        if len(distance) and distance.min() <= 0.03 * self.scene.diagonal:
            self.on_pick(contact_sentence(self.scene, int(distance.argmin())))


def _color_bar(plotter: Any, shaded: parts.Shade) -> None:
    import pyvista

    mapper, kinds = pyvista.DataSetMapper(), shaded.kinds
    # a legend of VTK would write the words in their colours, and pale ones cannot be read
    names = {number + 0.5: name for number, (name, _) in enumerate(reversed(kinds))}
    colors = [color for _, color in reversed(kinds)]
    ends = (0, len(kinds)) if kinds else (shaded.norm.vmin, shaded.norm.vmax)
    mapper.lookup_table = pyvista.LookupTable(
        colors or shaded.map, len(kinds) or 256, scalar_range=ends, annotations=names
    )
    bar = plotter.add_scalar_bar(
        shaded.title, mapper=mapper, vertical=True, position_x=0.86, position_y=0.25, width=0.06, height=0.5,
        fmt="%.3g", color=parts.INK, title_font_size=16, label_font_size=14, n_labels=0 if kinds else 5,
    )  # fmt: skip
    bar.SetTextPosition(not kinds)  # away from the body: numbers after the bar, and names opposite to where numbers are
