"""The ground: formulas, height maps, elevation models, synthetic terrain."""
