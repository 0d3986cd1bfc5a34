"""Engines that `python benchmarks compared` runs, one module each."""
