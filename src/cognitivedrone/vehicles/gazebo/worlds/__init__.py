"""Files of worlds: stages and the vehicle as SDF, and what is imported from Gazebo classic."""
