"""The rod in space: a round rod under a single contact force bends in the plane of its clamp and that force.

Units (1) as in `planar`: lengths in rod lengths ``L``, forces in ``EI/L²``, moments in ``EI/L``; angles in radians.  Clamp's
frame: y along the undeformed rod, x along the line of the sweep (the base moves in -x), z out of the slice.

==========================  ===========================================================================================
``t0``, ``t1``              tangent of the rod at the clamp, ``(0, 1, 0)``, and at the contact ``s1``
``F``, ``f0 = -F``, ``m0``  contact force on the rod; support reactions at the clamp, which a six-axis sensor measures
``e``, ``b = e × t0``       direction ``(cos ω, 0, sin ω)`` in which the rod bends, and the normal of its bending plane
``α``, ``q``, ``β``         as in the plane of bending: `planar.elastica`, `planar.reconstruction`
``n``, ``ζ``                outward normal of the body at the contact, angle between F and n: ``tan ζ <= μ``
==========================  ===========================================================================================
"""
