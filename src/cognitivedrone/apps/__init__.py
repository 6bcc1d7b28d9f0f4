"""The commands `fly` and `sim`: fly a drone with a live view and a log, and serve the simulator as a vehicle."""
