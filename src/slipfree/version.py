"""The version of the package, for results to carry."""

__version__ = "0.2.0.dev0"
