"""A three-dimensional canvas: bodies, points, tubes and lines before a camera in parallel projection."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.pictures.parts import ShownSweep
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import INK, ROD, TANGENTIAL

# Rendered so much larger and averaged: smooth edges on any renderer.
_SUPERSAMPLING = 2
# From above the front.
DIRECTION = (1.0, -1.3, 0.8)
# Corners that are drawn as edges, in degrees.
_EDGE = 30.0


class Canvas:
    """Bodies, points and lines before a camera that sees some corners (k, 3) whole, in parallel projection."""

    def __init__(
        self, corners: Array, direction: Any = DIRECTION, up: Any = (0.0, 0.0, 1.0), *, off_screen: bool = True
    ) -> None:
        import pyvista

        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=[64, 64] if off_screen else [1200, 900])
        self.dots = _SUPERSAMPLING if off_screen else 1
        self.plotter.set_background("white")
        self.plotter.suppress_rendering = off_screen  # until an image is asked for
        if off_screen:
            self.plotter.render_window.SetMultiSamples(0)  # the larger image does that
        self.corners = corners
        self.size = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0  # one point is as large as you please
        toward = np.asarray(direction, dtype=float)
        self.toward = toward / np.linalg.norm(toward)
        right = np.cross(np.asarray(up, dtype=float), self.toward)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.toward, self.right)

    def add_body(self, mesh: Any, color: Any, *, edges: Any = None, ambient: float = 0.45, opacity: float = 1.0) -> Any:
        """A mesh in one colour or in one (v, 3) for each vertex, its sharp edges drawn.  Returns the mesh's actor."""
        import pyvista

        shape = pyvista.wrap(mesh)
        light = dict(ambient=ambient, diffuse=1 - ambient, specular=0.0, opacity=opacity)
        if isinstance(color, str):
            actor = self.plotter.add_mesh(shape, color=color, **light)
        else:
            shape.point_data["rgb"] = color
            actor = self.plotter.add_mesh(shape, scalars="rgb", rgb=True, **light)
        sharp = pyvista.wrap(mesh if edges is None else edges).extract_feature_edges(
            _EDGE, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
        )
        if sharp.n_cells and opacity == 1:
            sharp.points = sharp.points + 1e-3 * self.size * self.toward  # before the faces
            self.plotter.add_mesh(sharp, color="#4a4f55", line_width=self.dots)
        return actor

    def backdrop(self, scene: Scene) -> None:
        """A body inside the contacts, so that those behind it do not shine through."""
        body = scene.surface
        if body is None:
            try:
                body = hull(scene.points)
            except InputError:  # contacts in a plane hide nothing
                return
        body = body.copy()
        body.vertices = body.vertices - 3e-3 * self.size * self.toward
        self.add_body(body, "#eef0f3", ambient=0.6)

    def add_points(self, points: Array, color: Any, size: float) -> Any:
        """Points (n, 3) as balls of so many pixels, in one colour or in their own (n, 3).  Returns their actor."""
        import pyvista

        cloud = pyvista.PolyData(np.asarray(points))
        how = dict(point_size=size * self.dots, render_points_as_spheres=True, ambient=0.6, diffuse=0.4)
        if isinstance(color, str):
            return self.plotter.add_mesh(cloud, color=color, **how)
        cloud["rgb"] = color
        return self.plotter.add_mesh(cloud, scalars="rgb", rgb=True, **how)

    def add_lines(self, lines: Array, color: str, width: float) -> list[Any]:
        """Lines (k, p, 3) of so many pixels.  Returns their actors."""
        import pyvista

        k, p = lines.shape[:2]
        if not k:
            return []
        cells = np.column_stack([np.full(k, p), np.arange(k * p).reshape(k, p)])
        shape = pyvista.PolyData(lines.reshape(-1, 3) + 2e-3 * self.size * self.toward, lines=cells.ravel())
        return [self.plotter.add_mesh(shape, color=color, line_width=width * self.dots, lighting=False)]

    def add_tube(self, line: Array, color: str, radius: float) -> Any:
        """A line (p, 3) of a thickness relative to the size.  Returns its actor."""
        import pyvista

        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        distinct = line[np.insert(step > 1e-6 * self.size, 0, True)]
        tube = pyvista.lines_from_points(distinct).tube(radius=radius * self.size, n_sides=12, capping=True)
        return self.plotter.add_mesh(tube, color=color)

    def add_rods(self, one: ShownSweep, states: NDArray[np.integer]) -> list[Any]:
        """Bent rods with their clamps and contacts.  Returns their actors."""
        import pyvista

        actors = []
        thick = 0.006 * self.size
        for k in states:
            whole = np.concatenate([one.curved[k], one.straight[k, 1:]])
            actors.append(self.add_tube(whole, ROD, 0.003))
            clamp = pyvista.Cube(x_length=3 * thick, y_length=3 * thick, z_length=3 * thick)
            clamp.points = one.base[k] + clamp.points @ one.axes - 1.5 * thick * one.axes[1]
            actors.append(self.plotter.add_mesh(clamp, color=INK))
            ball = pyvista.Sphere(radius=1.7 * thick, center=one.contact[k])
            actors.append(self.plotter.add_mesh(ball, color=TANGENTIAL))
        return actors

    def add_arrow(self, line: Array) -> None:
        """A line (2, 3) with a head at its end."""
        import pyvista

        self.add_lines(line[None], INK, 2)
        along = line[1] - line[0]
        head = 0.05 * self.size
        cone = pyvista.Cone(center=line[1], direction=along, height=head, radius=0.28 * head, resolution=24)
        self.plotter.add_mesh(cone, color=INK)

    def aim(self, width: int, height: int, floor: float = 0.0) -> float:
        """Turn the camera so that the corners fill an image; returns the world's length that is as wide as the image."""
        seen = self.corners @ np.stack([self.right, self.up], axis=1)
        low, high = seen.min(axis=0), seen.max(axis=0)
        middle = (low + high) / 2
        depth = self.corners @ self.toward
        # a margin around, and so many pixels of room below
        free = height - floor
        unit = min(0.94 * free / (high[1] - low[1] or 1.0), 0.94 * width / (high[0] - low[0] or 1.0))  # pixels
        center = middle[0] * self.right + (middle[1] - floor / 2 / unit) * self.up + depth.mean() * self.toward
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point = center
        camera.position = center + 3 * self.size * self.toward
        camera.up = self.up
        camera.parallel_scale = height / 2 / unit
        self.plotter.renderer.ResetCameraClippingRange()
        return float(width / unit)

    def image(self, width: int, height: int, floor: float = 0.0) -> tuple[NDArray[np.uint8], float]:
        """(height, width, 3) what the camera sees, and the world's length that is as wide."""
        from PIL import Image

        across = self.aim(width, height, floor)
        size = [width * _SUPERSAMPLING, height * _SUPERSAMPLING]
        if list(self.plotter.window_size) != size:
            self.plotter.window_size = size
        self.plotter.suppress_rendering = False
        self.plotter.render()
        large = Image.fromarray(self.plotter.screenshot(return_img=True)[:, :, :3])
        self.plotter.suppress_rendering = True
        return np.asarray(large.reduce(_SUPERSAMPLING)), across
