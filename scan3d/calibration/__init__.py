"""Calibration of a rig by touches of a reference: its rod, its clamp and its sensor, with their uncertainties.

`model` has the equations between a rig and what it touches, which `references` describes, `fit` chooses the rows of a recording
that are used and solves the equations by least squares, and `report` states and keeps what was found.
"""
