"""Mobility maps: where and how a vehicle stands, for every cell and heading of a map."""
