"""The link to a vehicle: bytes, messages, whose they are, and their log."""
