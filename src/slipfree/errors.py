"""Exceptions raised by the package."""

from __future__ import annotations


class SlipfreeError(Exception):
    """Base class: catch this to catch every error of the package."""


class ModelError(SlipfreeError, ValueError):
    """Invalid or ill-posed input: geometry, shapes, domain, or a start off the ground."""


class DataError(SlipfreeError, ValueError):
    """A file cannot be read, or its contents cannot be used."""


def missing_package(package: str, extra: str) -> str:
    """Return how to install an optional package, for the message of an error."""
    return (
        f"expected the package {package}, found none; in the folder of slipfree: "
        f"python -m pip install '.[{extra}]'"
    )
