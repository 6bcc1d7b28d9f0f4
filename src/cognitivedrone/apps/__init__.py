"""Where a person sits: the commands that fly a drone, show and record the flight, and serve the simulator as one."""
