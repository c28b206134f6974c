"""The allowed values of the settings that are chosen by name.

Every list stands here and nowhere else.  The tuples are plain, so that ``scan3d --help`` does not need a numerical library.
"""

MODELS = ("planar", "spatial")
"""Models of contact: the rod stays in its slice, or it bends where the contact force pushes it; the first is the default."""
SPACINGS = ("cosine", "uniform", "adaptive")
"""Rules for the heights of the slices."""
STANDOFFS = ("follow", "fixed")
"""Whether the base line follows each slice, or keeps clear of the widest slice."""
METHODS = ("auto", "hull", "bracket", "support", "regression", "poisson", "ball-pivoting")
"""Methods that make a surface from contacts; ``bracket`` estimates it between the certified bounds, ``regression`` fits planes
to noisy contacts."""
VIEWS = ("cloud", "surface", "bound", "compare", "explain")
"""What a picture can show."""
COLORS = ("phase", "force", "friction", "error", "bending")
"""The quantities by which contacts can be coloured."""
MOVIES = ("sweep", "growth")
"""What a movie can show; the first is the default."""
EXPORTS = ("surface", "cloud")
"""What can be exported of a scan; the first is the default where a file can contain either."""
TARES = ("auto", "constant", "linear", "sweep")
"""Models of what a sensor shows in the air; the first is the default."""
SHELLS = ("bash", "zsh", "fish")
"""Shells for which there is a completion script."""
