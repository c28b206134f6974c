"""Calibration of a rig by touches of a reference: its rod, its clamp and its sensor, with their uncertainties.

`model` has the equations between a reference and the rig that touches it, `rows` chooses the rows of a recording that are
used, `fit` solves the equations by least squares, `report` states what was found and how well, and `file` keeps it.
"""
