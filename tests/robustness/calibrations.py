"""Rigs that touch a reference, each seed with other noise: do the stated intervals of a calibration hold?

    python -m tests.robustness.calibrations [--reference sphere] [--count 200] [--first 0] [--mixing 0.01] [--pink 0.5]

The rig is that of `tests.rigs.Truth`: 30 sweeps, force noise of 0.2 % of the largest force, a sensor turned by 30° and 20 mm
away, a bias of 5 % and a drift of 1 %, pose jitter of 20 µm.

The table has for each quantity its stated standard deviation, the root mean square of its errors, the mean error in standard
deviations, and how many of the 95 % intervals hold.  Fails if these are not 90 to 98 % over all quantities of the rig.
With `--pink` that fraction of the noise's variance has the spectrum 1/f.
"""

import dataclasses
import sys
import time

import numpy as np

import scan3d
from tests import references, rigs
from tests.robustness import options


def main() -> int:
    counted = dict(count=200, samples=120, first=0, pink=0.0, mixing=0.0)
    arguments = options(__doc__, reference="sphere", **counted)
    truth, deviations, errors, warned = rigs.Truth(mixing=arguments.mixing), [], [], 0
    touched, motion, reference = references.of(arguments.reference, truth)
    start = time.process_time()
    for seed in range(arguments.first, arguments.first + arguments.count):
        # the noise of a sensor with 1/f noise is not known beforehand
        recording = rigs.recorded(
            truth, seed, motion=motion, samples=arguments.samples, pink=arguments.pink, stated=not arguments.pink
        )
        found = scan3d.calibrate(recording, touched)
        warned += any("noise" in sentence for sentence in found.sentences)
        # where each sweep has a tare of its own, it has no true value to compare with
        left_out = ("tare", "drift") if arguments.pink else ()
        kept = [k for k, name in enumerate(found.names) if not name.startswith(left_out)]
        names = tuple(found.names[k] for k in kept)
        found_names = dataclasses.replace(found, names=names)
        true = rigs.truth_of(
            found_names, truth, recording, motion=motion, reference=reference, samples=arguments.samples
        )
        deviations.append(found.standard_deviations[kept])
        errors.append(found.values[kept] - true)
    seconds = (time.process_time() - start) / arguments.count
    sd, error = np.array(deviations), np.array(errors)
    holds = np.abs(error) < 1.96 * sd
    print(
        f"{arguments.count} seeds, {found.details['contacts']} contacts, {seconds:.2f} s of processor time each; "
        f"{warned} with a sentence on noise that does not explain the contacts"
    )
    print(f"{'quantity':24} {'stated sd':>10} {'rms error':>10} {'mean/sd':>8} {'95 % holds':>10}")
    for k, name in enumerate(names):
        rms, mean = np.sqrt((error[:, k] ** 2).mean()), (error[:, k] / sd[:, k]).mean()
        print(f"{name:24} {sd[:, k].mean():10.3g} {rms:10.3g} {mean:8.2f} {holds[:, k].mean():10.3f}")
    rig = np.array([not name.startswith(("tare", "drift")) for name in names])
    print(f"{'quantities of the rig':24} {'':30} {holds[:, rig].mean():10.3f}")
    print(f"{'all quantities':24} {'':30} {holds.mean():10.3f}")
    return 0 if 0.9 <= holds[:, rig].mean() <= 0.98 else 1


if __name__ == "__main__":
    sys.exit(main())
