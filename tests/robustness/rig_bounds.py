"""Does the certified bound hold where the calibration of the rig is uncertain, and the touches of the body are accurate?

    python -m tests.robustness.rig_bounds [--bodies egg.stl cube.stl] [--count 40] [--first 0] [--touches 12] [--slices 24]
                                          [--quick]

Each seed calibrates the rig of `tests.rigs.Truth` by few touches of a sphere under noise.  Exact touches of a body, as the true
rig logs them, are corrected by this calibration and reconstructed.  A row has the distance of the inner body from the true
one, the bound without what the calibration leaves uncertain and whether it holds, and the same with it.  With `--quick` no
rig is calibrated: the errors of the rig are drawn from one covariance.  Fails if the bound with the uncertainty fails in more
than 5 % of the seeds of a body.
"""

import sys
from dataclasses import replace

import numpy as np

import scan3d
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.errors import with_rig_errors
from scan3d.surfaces import enclosure
from tests import rigs
from tests.rig_errors import calibrated, displaced, logged, typical
from tests.robustness import options
from tests.sample_bodies import MESHES


def touched(mesh, slices):
    """Exact touches by the true rod, on a table that is known."""
    truth = rigs.Truth()
    rod = scan3d.Rod(truth.length, truth.stiffness, rigs.ROD.diameter_m)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=slices, friction=0.3, samples=40, rod=rod))
    return replace(recording, table_m=mesh.bounds[0, 2] / 1000)


def corrected(recording, seed, touches, quick):
    """The recording as it is after the correction by a calibration that is off."""
    if quick:
        rig = typical(six=False)
        drawn = np.random.default_rng(seed).normal(size=rig.components().shape[1])
        return replace(displaced(recording, rig.components() @ drawn), rig=rig)
    rig, truth = calibrated(seed, sweeps=touches)
    return rig.applied(logged(recording, truth))


def measure(name, given):
    """All seeds of a body.  Returns the number of bounds that fail with the uncertainty of the calibration."""
    mesh = scan3d.load_mesh(MESHES / name)
    recording = touched(mesh, given.slices)
    print(f"{name}: lengths in mm\n{'seed':>5} {'error':>9} {'without':>9} {'holds':>5} {'with':>9} {'holds':>5}")
    failed = np.zeros(2, dtype=int)
    for seed in range(given.first, given.first + given.count):
        found = corrected(recording, seed, given.touches, given.quick)
        cloud = with_rig_errors(contacts(found), found)
        row = [f"{seed:5}"]
        for k, part in enumerate((replace(cloud, calibration=None), cloud)):
            bounds = enclosure(part)
            error = scan3d.compare(bounds.inner, mesh).hausdorff
            failed[k] += error > bounds.bound
            row += [f"{error:9.4f}"] * (k == 0) + [f"{bounds.bound:9.4f} {'yes' if error <= bounds.bound else 'NO':>5}"]
        print(*row, flush=True)
    print(f"fail without the calibration's uncertainty: {failed[0]} of {given.count}; with it: {failed[1]}")
    return failed[1]


def main() -> int:
    given = options(__doc__, bodies=["egg.stl", "cube.stl"], count=40, first=0, touches=12, slices=24, quick=False)
    failed = [measure(name, given) for name in given.bodies]
    return int(max(failed) > 0.05 * given.count)


if __name__ == "__main__":
    sys.exit(main())
