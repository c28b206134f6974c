"""Contacts of a recording by one of the models of contact, planar or spatial."""

from __future__ import annotations

import numpy as np

from scan3d.choices import MODELS
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.errors import with_rig_errors
from scan3d.reconstruction.normals import with_slice_normals, with_smooth_fit
from scan3d.reconstruction.spatial import spatial_contacts
from scan3d.recording import SIX_AXES, Recording

# Largest position, force and moment in SI units.  Larger, and products of them would not be numbers of a computer; smaller,
# there is no need.
_LARGEST = 1e60


def reconstruct(recording: Recording, method: str = "closed-form", model: str | None = None) -> Cloud:
    """Contacts of a recording, simulated or measured, with the normals of the surface where they can be known.

    method
        that of `planar.reconstruct`, for the planar model; the spatial one has the closed form only.
    model
        'planar' or 'spatial'; None is spatial if the recording has six axes, else planar.

    Planar: the direction of a normal within its slice's plane comes from (14), its inclination to the plane from the slices
    below and above.  Spatial: normals come from the slip and the path of the contact along each sweep, or from the force where
    there is no friction; points lie inside the rod's centre line by its radius.  If the body proves smooth, all normals come
    from the support function fitted to all contacts.
    Raises InputError if the recording has no contact, numbers so large that their squares are none, or not the axes that the
    model needs, and ValueError for an unknown method.
    """
    if not isinstance(recording, Recording):
        raise InputError(f"contacts are reconstructed from a scan3d.Recording, got {type(recording).__name__}")
    if model not in (None, *MODELS):
        raise InputError(f"model must be one of {', '.join(MODELS)}, got {model!r}")
    six_axes = SIX_AXES if recording.six_axis else ()
    for name in ("position_m", "force_N", "moment_Nm", *six_axes):
        largest = float(np.abs(getattr(recording, name)).max())
        if largest > _LARGEST:
            raise InputError(f"recording: {name} holds {largest:.3g}; check its unit, which is that of SI")
    if model == "planar" or (model is None and not recording.six_axis):
        cloud = with_smooth_fit(with_slice_normals(contacts(recording, method)))
        return with_rig_errors(cloud, recording)
    if method != "closed-form":
        raise InputError(
            f"the spatial model has the method closed-form only, got {method!r}; or choose the planar model"
        )
    return with_rig_errors(spatial_contacts(recording), recording)
