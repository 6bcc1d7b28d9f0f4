"""Training of any small network: the contract of a recipe, the trainer, checkpoints, logs and prefetching."""
