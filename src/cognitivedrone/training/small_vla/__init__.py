"""Trainings of the small VLA: its network from flights, its language alone."""
