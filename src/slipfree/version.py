"""The version of the package, for results to carry."""

__version__ = "0.1.0"
