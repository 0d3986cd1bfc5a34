"""Records that all packages share."""
