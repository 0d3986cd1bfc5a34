"""TOML files: line numbers, types of values, errors."""
