"""Sweep a flexible rod along a contour, and reconstruct the contour from the reactions at the rod's clamp.

Units (1): lengths in rod lengths ``L``, forces in ``EI/L²``, moments in ``EI/L``; angles in radians.  Frame: the rod is
clamped at ``(x0, 0)`` and points up, the object lies above, the base moves in -x.

===================  ==================================================================================================
``s``, ``φ``, ``κ``  arc length in [0, 1], slope angle and curvature of the rod
``α̃`` (slope)        slope angle of the contour at the contact; tangent ``(cos α̃, sin α̃)``, outward normal ``(sin α̃, -cos α̃)``
``ζ``, ``μ``         friction angle and coefficient of friction, ``μ = tan ζ``
``α = α̃ + ζ``        direction of the contact force on the rod, ``f (sin α, -cos α)`` (2)
``s1``, ``φ1``       contact position along the rod, slope of the rod there
``f0x, f0y, m0z``    support reactions, the observables: ``-f sin α``, ``f cos α``, ``-κ(0)`` (8)
===================  ==================================================================================================

`sweep` is step 1 of the paper (contour → reactions), `reconstruct` step 2 (reactions → contacts).  Numbers in brackets are
equations of L. Merker, J. Steigenberger, C. Behn, "Friction invariant object reconstruction using a vibrissa-inspired
tactile sensor concept".

The model is quasi-static and planar.  A convex object is touched at one place at a time; on any other the rod may have several
contacts, which `reconstruct` does not tell from one: `second_contacts` finds those that can't be single.  The rod is straight,
cylindrical, weightless and rigidly clamped unless a `Rod` says otherwise: tapered or of a stiffness that varies, curved, heavy,
in a clamp that gives.
"""

from planar.any_body import SweepStatus
from planar.channels import Completed, complete, complete_by_moment, touched_at
from planar.contours import Circle, Contour, Contours, Curve, Ellipse, Polygon
from planar.hidden import (
    bridging,
    constant_friction_angle,
    passed,
    second_contacts,
)
from planar.reconstruction import (
    TOLERANCE,
    Contacts,
    ElasticLines,
    Errors,
    NormalSource,
    Status,
    elastic_lines,
    errors,
    jacobian,
    reconstruct,
)
from planar.rods import Rod, free_reactions
from planar.sweeping import EventKind, Events, Phase, Sweep, events, sweep, sweep_all

__all__ = [
    "TOLERANCE",
    "Circle",
    "Completed",
    "Contacts",
    "Contour",
    "Contours",
    "Curve",
    "ElasticLines",
    "Ellipse",
    "Errors",
    "EventKind",
    "Events",
    "NormalSource",
    "Phase",
    "Polygon",
    "Rod",
    "Status",
    "Sweep",
    "SweepStatus",
    "bridging",
    "complete",
    "complete_by_moment",
    "constant_friction_angle",
    "elastic_lines",
    "errors",
    "events",
    "free_reactions",
    "jacobian",
    "passed",
    "reconstruct",
    "second_contacts",
    "sweep",
    "sweep_all",
    "touched_at",
]


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module 'planar' has no attribute {name!r}")
    from importlib.metadata import version

    return version("scan3d")
