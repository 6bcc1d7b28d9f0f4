"""What connects the flight loop to vehicles outside this process: MAVLink, autopilots in the loop, cameras."""
