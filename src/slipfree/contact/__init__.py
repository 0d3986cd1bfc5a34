"""How wheels touch the ground."""
