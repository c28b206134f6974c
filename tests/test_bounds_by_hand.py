"""The bounds of `bracket` and `compare` on bodies whose bounds are computed by hand."""

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.bracket import bracket
from scan3d.cloud import contacts
from scan3d.comparison import compare

# Half the lengths of a box's edges.
HALF = np.array([10.0, 15.0, 20.0])


# --- the outer body: an upright box, whose slices all have the same support function ---


@pytest.fixture(scope="module")
def box_cloud():
    return contacts(scan3d.simulate(trimesh.creation.box(2 * HALF), scan3d.Plan(slices=8, spacing="uniform")))


def grown(z, levels, margin):
    """How much farther out than the box its outer body reaches at the heights z, when contacts are off by `margin`.

    The half-spaces lean by the secant from the slice behind, where the support may be smaller by the margin, to this one,
    where it may be larger: by 2 margin / spacing.  They are those of the slice below, from the second slice on, and of the
    slice above, down to the last but one.
    """
    growth = np.full(len(z), np.inf)
    for i, level in enumerate(levels):
        for behind in (i - 1, i + 1):
            if 0 <= behind < len(levels):
                spacing = level - levels[behind]
                beyond = (z - level) * np.sign(spacing) >= -1e-9
                # half-spaces bound the slab next to their slice, not those farther away
                next_to = levels[2 * i - behind] if 0 <= 2 * i - behind < len(levels) else np.sign(spacing) * np.inf
                beyond &= (z - next_to) * np.sign(spacing) <= 1e-9
                leaning = margin + 2 * margin * (z - level) / spacing
                growth = np.where(beyond, np.minimum(growth, leaning), growth)
    return growth


def check_reach(corners, growth):
    """Corners (w, 3) of the outer body are as far from the box as it has grown there, but for the angle between normals."""
    beyond = np.maximum(np.abs(corners[:, :2]) - HALF[:2], 0)
    assert (beyond <= growth[:, None] + 1e-9).all()
    distance = np.linalg.norm(beyond, axis=1)
    assert (distance >= growth - 1e-9).all()
    assert (distance <= 1.05 * growth + 1e-9).all()


@pytest.mark.parametrize("margin", [0.0, 0.01, 0.3])
def test_a_margin_moves_and_leans_the_half_spaces(box_cloud, margin):
    found = bracket(box_cloud, margin)
    levels = np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])
    corners = found.corners[(found.corners[:, 2] > levels[0]) & (found.corners[:, 2] < levels[-1])]
    assert len(corners) >= 4 * (len(levels) - 2)
    check_reach(corners, grown(corners[:, 2], levels, margin))
    if margin:
        # halfway between two slices both lean out by the margin once more
        middle = (levels[2] + levels[3]) / 2
        assert np.abs(corners[:, 2] - middle).min() < 1e-9
        assert grown(np.array([middle]), levels, margin) == pytest.approx(2 * margin)


@pytest.mark.parametrize("margin", [0.0, 0.01, 0.3])
def test_a_margin_leans_the_caps_as_far_as_the_next_empty_slice(box_cloud, margin):
    levels = np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])
    floor, ceiling = box_cloud.slice_height.min(), box_cloud.slice_height.max()
    found = bracket(box_cloud, margin)
    for end, last, before in ((ceiling, levels[-1], levels[-2]), (floor, levels[0], levels[1])):
        corners = found.corners[np.abs(found.corners[:, 2] - end) < 1e-9]
        reach = margin + 2 * margin * (end - last) / (last - before)
        check_reach(corners, np.full(len(corners), reach))


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_volumes_bound_is_that_of_the_outer_body(box_cloud, margin):
    """Integrated over the height: at each height the outer body is a rectangle and what lies within its growth."""
    levels = np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])
    z = np.linspace(box_cloud.slice_height.min(), box_cloud.slice_height.max(), 200_001)
    middles = (z[1:] + z[:-1]) / 2
    growth = grown(middles, levels, margin)
    area = 4 * HALF[:2].prod() + 4 * HALF[:2].sum() * growth + np.pi * growth**2
    found = bracket(box_cloud, margin)
    assert found.volume[1] == pytest.approx((area * np.diff(z)).sum(), rel=1e-5)
    assert found.volume[0] == pytest.approx(found.inner.volume)
    assert found.margin == margin


# --- compare: bodies that are convex but for rounding, or closed but for a pinhole ---


def box_with_a_valley(depth):
    """A cube whose top is cut along the lower diagonal: two corners lie `depth` lower, and so does the line between them."""
    cube = trimesh.creation.box((2, 2, 2))
    vertices = np.array(cube.vertices)
    top = vertices[:, 2] > 0
    low = top & (vertices[:, 0] * vertices[:, 1] < 0)
    vertices[low, 2] -= depth
    (a, c), (b, d) = np.flatnonzero(top & ~low), np.flatnonzero(low)
    sides = [face for face in cube.faces if not top[face].all()]
    for face in ([a, b, d], [c, d, b]):
        upward = np.cross(vertices[face[1]] - vertices[face[0]], vertices[face[2]] - vertices[face[0]])[2] > 0
        sides.append(face if upward else face[::-1])
    return trimesh.Trimesh(vertices, sides, process=False)


def test_the_bound_allows_for_what_lies_below_the_hull():
    """A ridge over a valley: at all vertices the two are `height` apart, in the middle by the valley's depth more."""
    depth, height = 2e-6, 0.1
    valley = box_with_a_valley(depth)
    raised = np.array(valley.vertices)
    raised[raised[:, 2] > 0, 2] += height
    ridge = trimesh.Trimesh(raised, process=False).convex_hull
    result = compare(ridge, valley)
    assert not result.exact
    assert result.lower <= height + depth
    assert result.upper >= height + depth * (1 - 1e-3)
    assert result.upper <= height * 1.001


def test_the_bound_of_the_nearer_side_allows_for_what_lies_below_the_hull():
    """A wedge whose ridge crosses over the valley, its other vertices lower: the cube's bottom is farther from the wedge."""
    depth, height = 2e-6, 0.1
    valley = box_with_a_valley(depth)
    upper = valley.vertices[(valley.vertices[:, 2] > 0) & (valley.vertices[:, 0] * valley.vertices[:, 1] > 0)]
    beside = [(0.2, -0.2, 1 + height / 2), (-0.2, 0.2, 1 + height / 2)]
    wedge = trimesh.Trimesh(np.vstack([upper + np.array([0, 0, height]), beside]), process=False).convex_hull
    result = compare(wedge, valley)
    assert not result.exact
    assert result.surface_to_mesh_upper < 0.5 * result.mesh_to_surface
    assert result.surface_to_mesh <= height + depth
    assert result.surface_to_mesh_upper >= height + depth * (1 - 1e-3)
    # in the middle of the upper faces the surface lies 2/3 of the depth below its hull, and three times that is allowed
    # for, along rays from the middle of the cube, whose corners are √3 times as far as its faces
    assert result.surface_to_mesh_upper == pytest.approx(height + 2 * np.sqrt(3) * depth, abs=1e-3 * depth)


def test_a_pinhole_counts():
    """A cube with a hole smaller than what the winding number resolves: its middle is as far from the surface as the rim."""
    side = 2e-3
    cube = trimesh.creation.box((2, 2, 2))
    rim = side / np.sqrt(3) * np.array([(np.cos(t), np.sin(t)) for t in 2 * np.pi * np.arange(3) / 3])
    vertices = np.vstack([cube.vertices, np.column_stack([rim, np.ones(3)])])
    top = [face for face in cube.faces if (cube.vertices[face, 2] > 0).all()]
    rest = [face for face in cube.faces if not (cube.vertices[face, 2] > 0).all()]
    corners = np.unique(top)
    corners = corners[np.argsort(np.arctan2(*cube.vertices[corners, 1::-1].T))]
    # the ring between square and triangle, in the order of the angle
    outer, inner = list(corners), [8, 9, 10]
    ring = ring_between(vertices, outer, inner)
    holed = trimesh.Trimesh(vertices, np.array([*rest, *ring]), process=False)
    assert holed.area == pytest.approx(24 - np.sqrt(3) / 4 * side**2, rel=1e-12)
    truth = side / (2 * np.sqrt(3))
    for result in (compare(cube, holed), compare(holed, cube)):
        assert not result.exact
        assert result.lower <= truth * (1 + 1e-12)
        assert result.upper >= truth * (1 - 1e-12)


def ring_between(vertices, outer, inner):
    """Upward triangles between two rings of vertices around the z axis, by advancing on that whose next angle is smaller."""

    def angle(k):
        return np.arctan2(vertices[k, 1], vertices[k, 0]) % (2 * np.pi)

    outer, inner = sorted(outer, key=angle), sorted(inner, key=angle)
    i = j = 0
    faces = []
    while i < len(outer) or j < len(inner):
        a, b = outer[i % len(outer)], inner[j % len(inner)]
        next_a = angle(outer[(i + 1) % len(outer)]) + 2 * np.pi * ((i + 1) // len(outer))
        next_b = angle(inner[(j + 1) % len(inner)]) + 2 * np.pi * ((j + 1) // len(inner))
        if j == len(inner) or (i < len(outer) and next_a <= next_b):
            faces.append((a, outer[(i + 1) % len(outer)], b))
            i += 1
        else:
            faces.append((a, inner[(j + 1) % len(inner)], b))
            j += 1
    return faces
