"""Vehicles: trees of joints with wheels."""
