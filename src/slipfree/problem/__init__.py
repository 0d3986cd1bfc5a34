"""Problem files: what they hold, how they are read, and what comes of them."""
