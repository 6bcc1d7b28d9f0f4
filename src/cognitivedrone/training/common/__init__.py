"""Shared parts of all training runs: the trainer, checkpoints, curves, samples and their ground truth."""
