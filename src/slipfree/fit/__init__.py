"""Calibration: parameters of a vehicle and of a law, fitted to logs of wheel rates and poses."""
