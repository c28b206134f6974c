"""Import with a calibrated rig: its frames and its rod take the place of those of a map.

A calibration states the clamp in the frame of the poses that it was given, and the sensor in that clamp's frame, starting from
the reactions that it was given.  If these came from an import, the map of that import had turned and moved them already: the
calibration keeps its frames, so that the same physical frames follow for any later map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from scan3d.errors import InputError
from scan3d.files.section import Section
from scan3d.frames import Frame, euler_of
from scan3d.laboratory.calibration_file import read_rig
from scan3d.laboratory.calibration_result import Calibration
from scan3d.laboratory.calibration_uncertainty import rig_uncertainty
from scan3d.laboratory.maps import Map, read_frame


def with_rig(map: Map, rig: Calibration | str | Path) -> Map:
    """The map with the sensor, the clamp and the rod of a calibration, which may be the path of its file.

    The sign of the wrench, the units and the columns stay those of the map, and the zero is found in the log's own stretches in
    the air: it changes from day to day.  Raises InputError as `scan3d.read_rig`.
    """
    found = rig if isinstance(rig, Calibration) else read_rig(rig)
    sensor_before, clamp_before = (
        read_frame(Section("the rig", found.map_frames.get(title, {}), f"map.{title}")) for title in ("sensor", "clamp")
    )
    sensor, clamp = found.frames()
    sensor, clamp = sensor_before.within(sensor), clamp.within(clamp_before)
    used: dict[str, Any] = {"name": "calibration" if isinstance(rig, Calibration) else Path(rig).name}
    used |= {"sensor": _section(sensor), "clamp": _section(clamp)}
    return replace(
        map,
        sensor=sensor,
        clamp=clamp,
        rod=found.rod,
        rig=used,
        uncertainty=rig_uncertainty(found),
        noise_pose_m=found.pose_noise_m if map.noise_pose_m is None else map.noise_pose_m,
    )


def not_rigged(source: Mapping[str, Any], name: str) -> None:
    """Raise InputError for the source of a recording that a rig has corrected: frames would be applied twice."""
    if source.get("calibrated"):
        raise InputError(
            f"{name} was corrected by a calibrated rig already; leave --rig out, or import the table again without it"
        )


def _section(frame: Frame) -> dict[str, list[float]]:
    return {
        "position_mm": [float(1000 * value) for value in frame.position_m],
        "euler_deg": [float(value) for value in euler_of(frame.turn)],
    }
