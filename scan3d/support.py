"""Former module of the fitted support function, kept for one version; use `scan3d.geometry.support`."""

from scan3d.geometry.support import SupportFit, fit_support

__all__ = ["SupportFit", "fit_support"]
