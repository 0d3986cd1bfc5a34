"""Vehicles that come with the package."""
