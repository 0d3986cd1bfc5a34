"""Climbing of steps in the plane: articulated vehicles on three axles, with inertia and impacts."""
