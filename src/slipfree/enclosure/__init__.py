"""Rest poses that hold for every ground within a distance of the map."""
