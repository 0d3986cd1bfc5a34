"""TOML files: lines of keys, types of values, errors."""
