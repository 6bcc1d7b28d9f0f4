"""What all trainings share: the trainer, checkpoints, curves, samples and their ground truth."""
