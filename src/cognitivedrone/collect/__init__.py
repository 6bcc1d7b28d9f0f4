"""Collection of training data: the expert flies, episodes are recorded and stored."""
