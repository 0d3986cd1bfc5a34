"""Grounds: formulas, height maps, elevation models and synthetic terrain."""
