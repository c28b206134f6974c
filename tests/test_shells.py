"""Shells that overlap, touch or lie in each other: the body is their union, against cells that are counted."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_files import save

import scan3d
from scan3d.files.meshes import load_mesh
from scan3d.geometry.hulls import is_convex, turns
from scan3d.geometry.sections import slice_outlines
from scan3d.geometry.shells import shells, united, whole_body
from scan3d.geometry.triangles import distinct_rows

SIZE = 5


def box(low, high, diagonal=False):
    """A box, whose sides may be cut along their other diagonals, so that two that touch have no triangle in common."""
    made = trimesh.creation.box(bounds=[low, high])
    if diagonal:
        made.vertices = np.asarray(made.vertices) * [-1, 1, 1] + [low[0] + high[0], 0, 0]
        made.invert()
    return made


def joined(parts):
    """All faces with equal vertices merged, as a file of triangles gives them."""
    points = np.concatenate([np.asarray(part.vertices) for part in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([np.asarray(part.faces) + start for part, start in zip(parts, starts, strict=False)])
    first, number = distinct_rows(points)
    return points[first], number[faces]


spans = st.tuples(st.integers(0, SIZE - 1), st.integers(0, SIZE - 1)).map(lambda pair: (min(pair), max(pair) + 1))


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.tuples(spans, spans, spans), st.booleans()), min_size=1, max_size=5))
def test_boxes_on_a_grid_against_cells_that_are_counted(drawn):
    cells, parts = np.zeros((SIZE + 2,) * 3, dtype=bool), []
    for (x, y, z), diagonal in drawn:
        cells[x[0] + 1 : x[1] + 1, y[0] + 1 : y[1] + 1, z[0] + 1 : z[1] + 1] = True
        parts.append(box([x[0], y[0], z[0]], [x[1], y[1], z[1]], diagonal))
    points, faces = joined(parts)
    union = united(points, faces)
    body = trimesh.Trimesh(*(union or (points, faces)), process=False)
    area = sum(np.abs(np.diff(cells.astype(int), axis=axis)).sum() for axis in range(3))
    assert body.volume == pytest.approx(cells.sum(), rel=1e-12)
    assert body.area == pytest.approx(area, rel=1e-12)
    assert united(np.asarray(body.vertices), np.asarray(body.faces)) is None


def test_shells_at_a_common_edge_are_told_apart():
    """Boxes that have a side, an edge or a corner in common, one with a notch beside the other, and a ring of four."""
    for low in ((2, 0, 0), (2, 2, 0), (2, 2, 2)):
        label = shells(*joined([box([0, 0, 0], [2, 2, 2]), box(low, np.add(low, 2))]))
        assert np.array_equal(np.bincount(label), [12, 12])
    ring = [box(low, np.add(low, 2), k % 2) for k, low in enumerate([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)])]
    assert np.array_equal(np.bincount(shells(*joined(ring))), [12] * 4)


def test_a_cavity_stays_and_what_lies_in_it_is_a_part():
    outer, cavity, core = (trimesh.creation.icosphere(2, radius=r) for r in (10, 8, 5))
    cavity.invert()
    assert united(*joined([outer, cavity])) is None
    assert united(*joined([outer, cavity, core])) is None
    core.apply_translation([4, 0, 0])  # it meets the wall
    whole = trimesh.Trimesh(*united(*joined([outer, cavity, core])), process=False)
    assert outer.volume + cavity.volume < whole.volume < outer.volume + cavity.volume + core.volume
    assert turns(np.asarray(whole.triangles) - [-5.0, 0, 0]) == pytest.approx(0, abs=1e-9)
    inner = trimesh.creation.icosphere(2, radius=8)
    assert trimesh.Trimesh(*united(*joined([outer, inner])), process=False).volume == pytest.approx(outer.volume)


@pytest.mark.parametrize(("start", "volume"), [(1, 3), (2, 4), (5, 4)])
def test_a_part_that_is_turned_wrongly_is_turned(tmp_path, start, volume):
    """Whether it overlaps another, touches it or lies apart; the volumes of both cancel."""
    parts = [box([0, 0, 0], [2, 1, 1]), box([start, 0, 0], [start + 2, 1, 1])]
    parts[1].invert()
    assert trimesh.Trimesh(*united(*joined(parts)), process=False).volume == pytest.approx(volume)
    assert load_mesh(save(tmp_path, trimesh.util.concatenate(parts), "parts.stl")).volume == pytest.approx(volume)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1.0, 1e9])
def test_parts_of_a_body_are_one_body(tmp_path, scale):
    """For volume, distance, convexity and sections alike; the right values are those of the box."""
    whole = box([-15, -10, -6], [15, 10, 6])
    for name, middle in (("touching", 0.0), ("overlapping", 2.0)):
        parts = [box([-15, -10, -6], [middle, 10, 6]), box([-middle, -10, -6], [15, 10, 6], diagonal=True)]
        mesh = trimesh.util.concatenate(parts)
        for one in (mesh, whole_scaled := whole.copy()):
            one.apply_scale(scale)
        body = load_mesh(save(tmp_path, mesh, f"{name}.ply"))
        assert is_convex(body)
        assert body.metadata["file_faces"] == 24
        assert body.volume == pytest.approx(7200 * scale**3)
        assert scan3d.compare(mesh, whole_scaled).hausdorff <= 1e-12 * scale
        assert scan3d.compare(mesh, whole_scaled).volume_error == pytest.approx(0, abs=1e-12)


def test_an_overlap_of_a_body_that_is_not_convex(tmp_path):
    """Two bars as an L: the outline of the section is that of the union, and so is the part of the hull that is empty."""
    bars = [box([0, 0, 0], [6, 2, 2]), box([0, 0, 0], [2, 6, 2], diagonal=True)]
    path = save(tmp_path, trimesh.util.concatenate(bars), "l.ply")
    body = load_mesh(path)
    assert body.volume == pytest.approx(40)
    assert body.area == pytest.approx(88)
    (outline,) = slice_outlines(body, np.eye(3), np.array([1.0]))[0]
    assert np.ptp(outline, axis=0) == pytest.approx([6, 6])
    filled = load_mesh(path, hull=True).metadata["filled"]
    assert filled["volume_relative"] == pytest.approx(1 - 40 / 56)


def test_other_meshes_stay_as_they_are():
    ball = trimesh.creation.icosphere(2)
    apart = trimesh.util.concatenate([ball, ball.copy().apply_translation([3, 0, 0])])
    sheet = trimesh.Trimesh(
        ball.vertices, np.concatenate([ball.faces, ball.faces[:1], ball.faces[:1, ::-1]]), process=False
    )
    for mesh in (ball, apart, trimesh.Trimesh(ball.vertices, ball.faces[:-1], process=False)):
        assert whole_body(mesh) is mesh
    assert whole_body(sheet).volume == pytest.approx(ball.volume)
