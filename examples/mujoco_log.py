"""How is a log of a simulator of robots read: contacts of a rod that MuJoCo drags along a cylinder?

In MuJoCo the rod is a chain of hinged links, whose joints have the stiffness of a steel wire, in a clamp that moves at a
constant speed.  A force and a torque sensor at the clamp are logged with its pose, and nothing else.  The recording is
reconstructed with the model of this program, which knows no links, no damping and no penalty forces; printed is how far the
contacts are from the cylinder.  `recording` is all that another simulator needs.

    pip install mujoco
    python examples/mujoco_log.py [--out DIR]

Reference: E. Todorov, T. Erez, Y. Tassa, MuJoCo: A physics engine for model-based control, IROS 2012.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import planar
import scan3d

ROD = scan3d.Rod.wire(length_m=0.2, diameter_m=0.5e-3, modulus_Pa=210e9)
LINKS, RADIUS_M, CENTRE_M, FRICTION = 24, 0.04, (0.0, 0.14), 0.3
# The clamp's way in x, and the time in which joints come to rest: the clamp moves by less than a thousandth of the rod then.
START_M, STOP_M, SPEED_M_S, DAMPING_S, ROWS = 0.06, -0.10, 0.01, 5e-3, 240


def model() -> str:
    """The clamp, whose frame is that of a recording, the chain along its y axis, and a cylinder across."""
    long, links = ROD.length_m / LINKS, ""
    stiffness = ROD.bending_stiffness_Nm2 / long
    # joints lie in the middles of segments: the first link is half as long, as is the last
    for k in reversed(range(LINKS)):
        start, end = (long / 2 if k == 0 else long), (long / 2 if k == LINKS - 1 else long)
        links = f"""<body pos="0 {start} 0"><joint axis="0 0 1" stiffness="{stiffness}" damping="{DAMPING_S * stiffness}"/>
            <geom type="capsule" fromto="0 0 0 0 {end} 0" size="{ROD.diameter_m / 2}" mass="1e-4"/>{links}</body>"""
    return f"""<mujoco>
        <option timestep="2e-4" gravity="0 0 0" integrator="implicitfast" cone="elliptic" impratio="100"/>
        <default><geom friction="{FRICTION} 0 0" contype="1" conaffinity="2" solref="0.004 1"/></default>
        <worldbody>
            <geom type="capsule" size="{RADIUS_M} 1" pos="{CENTRE_M[0]} {CENTRE_M[1]} 0" contype="2" conaffinity="1"/>
            <body><joint name="sweep" type="slide" axis="1 0 0"/><geom size="0.001" mass="1" contype="0" conaffinity="0"/>
                <body><site name="clamp"/><geom size="0.001" mass="1e-4" contype="0" conaffinity="0"/>{links}</body></body>
        </worldbody>
        <sensor><force site="clamp"/><torque site="clamp"/></sensor></mujoco>"""


def recording() -> scan3d.Recording:
    """What the sensors show while the clamp moves in -x.  Raises SystemExit without MuJoCo."""
    try:
        import mujoco
    except ModuleNotFoundError:
        raise SystemExit("this example needs MuJoCo: pip install mujoco") from None
    compiled = mujoco.MjModel.from_xml_string(model())
    data, log = mujoco.MjData(compiled), []
    steps = int((START_M - STOP_M) / SPEED_M_S / compiled.opt.timestep)
    for step in range(steps):
        data.qpos[0], data.qvel[0] = START_M - SPEED_M_S * data.time, -SPEED_M_S
        mujoco.mj_step(compiled, data)
        if step % (steps // ROWS) == 0:
            log.append([data.qpos[0], *data.sensordata])
    place, *wrench = np.array(log).T
    force, moment = np.array(wrench[:2]).T, wrench[5]  # the sensor shows what the clamp does to the rod
    return scan3d.Recording(
        sweep=np.zeros(len(place), dtype=int),
        position_m=np.stack([place, 0 * place, 0 * place], axis=1),
        quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (len(place), 1)),
        force_N=force,
        moment_Nm=moment,
        rod=ROD,
        source={"kind": "MuJoCo", "links": LINKS},
    )


def main(argv: Sequence[str] | None = None) -> scan3d.Cloud:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, help="folder for the recording and its contacts")
    out, log = parser.parse_args(argv).out, recording()
    cloud = scan3d.reconstruct(log)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        scan3d.write_recording(log, out / "mujoco.csv")
        cloud.save(out / "contacts.csv")
    off = 1e3 * np.abs(np.hypot(*(cloud.points[:, :2] / 1e3 - CENTRE_M).T) - RADIUS_M)
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    print(f"{len(cloud)} contacts of {len(log)} rows")
    print(f"{np.median(off):.3f} mm off the cylinder in the median, {off.max():.3f} mm at most")
    print(f"friction {np.median(cloud.friction[tangential]):.4f} in the median, of {FRICTION}")
    return cloud


if __name__ == "__main__":
    main()
