"""Scores of a reasoner alone, asked about the first frames of every flight."""
