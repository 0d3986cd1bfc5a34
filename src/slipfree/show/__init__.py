"""Figures, scenes, films, viewer and report of results."""
