"""Triangles: which faces of a closed surface are wound against the others."""

import numpy as np
import pytest
import trimesh
from shapes import ball, cube, without

from scan3d.geometry.triangles import (
    mirrored_faces,
)


@pytest.mark.parametrize("body", [cube(), ball(3, 40)], ids=["cube", "ball"])
@pytest.mark.parametrize("turned", [[], [0], [1], [2, 5], [0, 1, 7]])
def test_faces_wound_against_the_first_one_are_found(body, turned):
    faces = body.faces.copy()
    faces[turned] = faces[turned, ::-1]
    expected = np.isin(np.arange(len(faces)), turned) != (0 in turned)
    assert mirrored_faces(faces).tolist() == expected.tolist()


def test_no_face_is_mirrored_on_a_surface_that_is_not_one_closed_one():
    body = cube()
    two = trimesh.util.concatenate([cube(), cube(shift=(5.0, 0.0, 0.0))])
    # the projective plane: six vertices, each edge in two of the ten faces, and one side only
    one_sided = np.array(
        [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5), (0, 5, 1), (1, 2, 4), (2, 3, 5), (3, 4, 1), (4, 5, 2), (5, 1, 3)]
    )
    for faces in (
        without(body, np.arange(12) > 0).faces,  # an odd number of edges
        without(body, np.arange(12) > 1).faces,
        np.vstack([body.faces, body.faces]),
        two.faces,
        one_sided,
    ):
        assert mirrored_faces(np.asarray(faces)) is None
