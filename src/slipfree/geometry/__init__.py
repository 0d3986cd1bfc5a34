"""Poses and twists of frames, surfaces, meshes and paths."""
