"""What settings may be, by name: plain tuples, so that ``scan3d --help`` needs no numerical library."""

SPACINGS = ("cosine", "uniform", "adaptive")
"""Heights of the slices."""
STANDOFFS = ("follow", "fixed")
"""Whether the base line follows each slice, or keeps clear of the widest."""
METHODS = ("auto", "hull", "bracket", "support", "poisson", "ball-pivoting")
"""Surfaces from contacts."""
VIEWS = ("cloud", "surface", "bound", "compare", "explain")
"""What a picture can show."""
COLORS = ("phase", "force", "friction", "error")
"""What contacts can be coloured by."""
MOVIES = ("sweep", "growth")
"""What a movie can show."""
EXPORTS = ("surface", "cloud")
"""What of a scan can be exported, in the order of preference where a file could hold both."""
SHELLS = ("bash", "zsh", "fish")
"""Shells for which there is a completion script."""
