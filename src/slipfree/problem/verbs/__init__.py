"""Verbs: what a problem file can ask for, one module per verb."""
