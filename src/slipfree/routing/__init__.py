"""Routes over a map: traversability, search, smoothing, regions."""
