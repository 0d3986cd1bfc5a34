"""Figures of a motion."""
