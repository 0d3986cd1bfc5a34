"""Models of motion and driving laws."""
