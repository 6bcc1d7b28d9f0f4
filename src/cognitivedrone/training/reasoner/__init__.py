"""Training runs of the small reasoner: its panel reader and its gate selector."""
