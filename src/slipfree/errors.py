"""Exceptions raised by the package."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slipfree.trajectory import Trajectory


class SlipfreeError(Exception):
    """Base class: catch this to catch every error of the package."""


class ModelError(SlipfreeError, ValueError):
    """The question is ill posed: geometry, shapes, domain, a start off the ground."""


class DataError(SlipfreeError, ValueError):
    """A file cannot be read, or what it holds cannot be used."""


class SolverError(SlipfreeError, RuntimeError):
    """The question was fine, but the solver found no answer.

    Attributes
    ----------
    trajectory : Trajectory or None
        What was reached before the solver stopped.
    """

    def __init__(self, message: str, trajectory: Trajectory | None = None) -> None:
        super().__init__(message)
        self.trajectory = trajectory
