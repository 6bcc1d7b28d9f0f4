"""What every rollout shares, whoever asks for it: the workers that fly."""
