"""Shared parts of all trainings: the trainer, checkpoints, curves, samples and their ground truth."""
