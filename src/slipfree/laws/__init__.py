"""Slip laws and wheel-ground laws: equations that models add to the contact of the wheels."""
