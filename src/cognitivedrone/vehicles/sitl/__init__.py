"""A real ArduCopter process on this project's physics."""
