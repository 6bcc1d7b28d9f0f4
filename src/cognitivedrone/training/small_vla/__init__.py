"""Training runs of the small VLA: the network from flights, and language alone."""
