"""Solvers of a DAE: starts, simulation and collocation, with trajectories as results."""
