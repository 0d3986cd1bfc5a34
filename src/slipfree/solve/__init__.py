"""Solvers: from a DAE to a trajectory."""
