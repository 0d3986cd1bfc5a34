"""Planning by optimal control: transcription, solution and verification."""
