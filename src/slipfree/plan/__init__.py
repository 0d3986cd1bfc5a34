"""Planning: routes over a map, and the regions they keep out of."""
