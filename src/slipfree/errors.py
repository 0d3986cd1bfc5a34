"""Exceptions raised by the package."""

from __future__ import annotations


class SlipfreeError(Exception):
    """Base class: catch this to catch every error of the package."""


class ModelError(SlipfreeError, ValueError):
    """The question is ill posed: geometry, shapes, domain, a start off the ground."""


class DataError(SlipfreeError, ValueError):
    """A file cannot be read, or its contents cannot be used."""
