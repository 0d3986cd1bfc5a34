"""Contact of the wheels with the ground."""
