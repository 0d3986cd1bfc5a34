"""Slip laws, wheel-ground laws and contact laws, which models add to the contact of the wheels."""
