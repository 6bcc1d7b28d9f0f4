"""Recorded flights: the in-memory episode, the store on disk, and the formats that trainers read."""
