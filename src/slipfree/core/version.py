"""Version of the package, stored in result files."""

__version__ = "0.2.0"
