"""Verbs of problem files, one module per verb."""
