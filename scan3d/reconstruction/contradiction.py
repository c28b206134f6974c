"""A contradiction between a recording and a model of contact."""

from __future__ import annotations

from typing import NamedTuple


class Contradiction(NamedTuple):
    """A contradiction between a recording and the model."""

    code: str
    message: str
    value: float
    """The number that the test found, as the message says."""
