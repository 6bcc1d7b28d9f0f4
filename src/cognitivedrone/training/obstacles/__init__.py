"""Training of the eye that sees what is in the way."""
