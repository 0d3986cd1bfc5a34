"""Vehicles in URDF files."""
