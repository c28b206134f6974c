"""Probings against MuJoCo: a chain of hinged links that is pushed along itself onto an inclined plane, with friction.

    pip install mujoco
    python -m tests.robustness.mujoco_chains

Printed are, for a rod whose length and stiffness EI are 1, how far the end of the chain was bent aside when the force reached
the stop force, and how far from it the contact lies that is reconstructed of force and moment at the clamp.  The exit code is 1
if one is off by more than 5e-5: the chain has a finite number of links, and is not quite at rest.
"""

from __future__ import annotations

from itertools import product

import mujoco
import numpy as np

import scan3d
from scan3d.reconstruction.probings import contacts
from scan3d.recording import Recording

LINKS, RADIUS, STOP, SPEED = 24, 5e-3, 0.03, 3e-4


def chain_before_plane(angle: float, friction: float) -> mujoco.MjModel:
    """A chain along y, whose joints lie in the middles of its segments so that it bends as a rod up to their length squared."""
    h = 1 / LINKS
    chain = f'<site name="end" pos="0 {h / 2} 0"/>'
    for k in reversed(range(LINKS)):
        start, long, is_last = (h / 2 if k == 0 else h), (h / 2 if k == LINKS - 1 else h), k == LINKS - 1
        chain = f"""<body pos="0 {start} 0"><joint axis="0 0 1" stiffness="{1 / h}" damping="{0.02 / h}"/>
            <geom type="capsule" fromto="0 0 0 0 {long} 0" size="{RADIUS}" mass="1e-3" contype="{int(is_last)}"/>
            {chain}</body>"""
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
        <option timestep="2e-4" gravity="0 0 0" integrator="implicitfast" cone="elliptic" impratio="100" tolerance="1e-14"/>
        <default><geom friction="0 0 0" conaffinity="0" contype="0"/></default>
        <worldbody>
            <geom type="plane" size="1 1 1" pos="0 {1 + RADIUS / np.cos(angle) + 1e-4} 0" conaffinity="1" solref="0.004 1"
                xyaxes="{np.cos(angle)} {np.sin(angle)} 0 0 0 1" friction="{friction} 0 0"/>
            <body><joint type="slide" axis="0 1 0"/><geom type="sphere" size="0.001" mass="1"/>{chain}</body>
        </worldbody></mujoco>""")


def pushed(model: mujoco.MjModel) -> tuple[float, np.ndarray, np.ndarray]:
    """Way of the clamp along y, place (3,) of the chain's end, and force (3,) on it as soon as it is the stop force."""
    data, wrench = mujoco.MjData(model), np.zeros(6)
    while True:
        data.qpos[0], data.qvel[0] = SPEED * data.time, SPEED
        mujoco.mj_step(model, data)
        force = np.zeros(3)
        for k in range(data.ncon):
            mujoco.mj_contactForce(model, data, k, wrench)
            force += data.contact[k].frame.reshape(3, 3).T @ wrench[:3]
        if np.linalg.norm(force) > STOP:
            return float(data.qpos[0]), data.site("end").xpos.copy(), force


def main() -> int:
    wrong = 0
    for degrees, friction in product((0, 20, 60), (0.0, 0.3)):
        way, end, force = pushed(chain_before_plane(np.deg2rad(degrees), friction))
        recording = Recording(
            sweep=np.zeros(2, dtype=int),
            position_m=np.array([[0, way - 0.1, 0], [0, way, 0]]),
            quaternion=np.tile([1.0, 0, 0, 0], (2, 1)),
            force_N=np.array([[0, 0], -force[:2]]),
            moment_Nm=np.array([0, -np.cross(end - [0, way, 0], force)[2]]),
            rod=scan3d.Rod(1.0, 1.0),
            noise_force_N=1e-6,
            noise_moment_Nm=1e-6,
            unit="m",
        )
        off = float(np.linalg.norm(contacts(recording, "planar").points[0] - end))
        wrong += off > 5e-5
        print(
            f"{degrees:3} degrees, friction {friction}: bent aside by {end[0]:.3e}, contact off by {off:.1e}",
            flush=True,
        )
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
