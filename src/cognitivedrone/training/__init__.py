"""Trains policies and reasoners: recipes, the stream of examples, the trainer."""
