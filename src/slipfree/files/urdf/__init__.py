"""Conversion of URDF files to vehicles."""
