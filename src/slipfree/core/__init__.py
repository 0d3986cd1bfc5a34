"""Models, records, facts, outcomes and errors, which all packages share."""
