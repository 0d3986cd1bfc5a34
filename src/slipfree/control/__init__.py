"""Driving laws."""
