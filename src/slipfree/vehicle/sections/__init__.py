"""Cross-sections of wheels."""
