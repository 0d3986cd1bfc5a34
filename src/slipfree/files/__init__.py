"""File formats: results, maps, vehicles, exports."""
