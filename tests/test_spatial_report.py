"""The report of a scan in space, as far as it does not depend on the surface."""

from types import SimpleNamespace

import numpy as np
import pytest
from spatial_scans import recorded

import scan3d
from scan3d.reconstruction import radius_errors
from scan3d.report import _counts, _friction, _thickness, summary


@pytest.fixture(scope="module")
def scanned():
    recording, points, normals = recorded((0.0, 0.4), diameter=0.01, substeps=1, directions=4, heights=5)
    return recording, scan3d.reconstruct(recording), points, normals


def test_counts_and_friction_of_a_scan_in_space(scanned):
    recording, cloud, points, _ = scanned
    counts = _counts(SimpleNamespace(recording=recording, cloud=cloud))
    assert (counts["slices"], counts["empty_slices"]) == (0, 0)
    assert counts["contacts"] == np.isfinite(points[:, 0]).sum()
    friction = _friction(cloud, "0.0:0.4")
    assert friction["slip_to_path_deg"] is None or friction["slip_to_path_deg"] < 5
    assert 0 <= friction["estimated_range"][0] <= friction["estimated_median"] <= friction["estimated_range"][1]


def test_what_the_radius_leaves_covers_the_errors(scanned):
    _, cloud, points, normals = scanned
    found = radius_errors(cloud)
    unknown = np.isnan(cloud.normals[:, 0])
    error = np.linalg.norm(cloud.points - (points - cloud.rod_radius * normals)[cloud.row], axis=1)
    assert found.moved == cloud.rod_radius > 0
    assert found.unknown_normals == unknown.sum() > 0
    assert np.percentile(error[unknown], 95) < 1.5 * found.left_unknown
    assert np.percentile(error[~unknown], 95) < found.left
    rod = _thickness(cloud)
    assert rod["diameter"] == pytest.approx(0.01 * cloud.rod_length)
    assert rod["radius"]["left"] == found.left


def test_the_summary_says_what_was_moved():
    data = {
        "model": "spatial",
        "counts": {"contacts": 5, "samples": 9, "sweeps": 2, "slices": 0, "light": 0},
        "rod": {"radius": {"moved": 0.25, "left": 1e-3, "unknown_normals": 2, "left_unknown": 0.02, "unit": "mm"}},
        "hausdorff": None,
        "contact_error": None,
        "source": {},
        "friction": {"estimated_median": None},
        "surface": {"method": "hull", "faces": 4, "watertight": True},
        "certificate": {"bound": None},
        "warnings": [],
    }
    text = summary(data)
    assert text.heading.endswith("2 sweeps in space")
    assert dict(text.rows)["rod's radius"] == (
        "contacts moved by 0.25 mm from the rod's centre line, which leaves errors up to 0.02 mm"
    )
