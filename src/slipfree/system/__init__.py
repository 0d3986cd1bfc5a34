"""Processes, signals, compiled libraries and files of the operating system."""
