"""Poses of frames and their twists."""
