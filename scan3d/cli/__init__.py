"""The `scan3d` command."""

from scan3d.cli.main import main

__all__ = ["main"]
