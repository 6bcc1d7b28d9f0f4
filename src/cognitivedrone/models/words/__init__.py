"""Sentences as vectors, sums, and the gate that a sentence means."""
