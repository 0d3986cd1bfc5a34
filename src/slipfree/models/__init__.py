"""Models of motion: functions that return a `Dae`."""
