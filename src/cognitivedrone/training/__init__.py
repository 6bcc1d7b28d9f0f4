"""Training of policies and reasoners: recipes, rollout streams, the trainer."""
