"""Sweeps: many runs of one problem with different values and seeds, and a table of results."""
