"""Problem files: schema, loading, solving and summaries."""
