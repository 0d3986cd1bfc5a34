"""Laws that drive a vehicle."""
