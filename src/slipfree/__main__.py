"""``python -m slipfree``."""

from slipfree.cli import main

main()
