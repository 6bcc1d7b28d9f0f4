"""Training data at scale: the expert flies, episodes are recorded and stored."""
