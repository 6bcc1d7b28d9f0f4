"""Recorded flights: the in-memory episode, the store on disk, and the exchange formats of trainers."""
