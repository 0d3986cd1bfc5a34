"""Very many poses and motions at once: fixed steps with exact contact, many lanes per register."""
