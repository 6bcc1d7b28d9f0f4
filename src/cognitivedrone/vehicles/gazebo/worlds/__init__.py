"""Files of worlds: stages and the vehicle as SDF."""
