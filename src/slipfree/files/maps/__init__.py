"""Elevation models: grids, rasters, scattered points."""
