"""The control loop: one for the simulator, software in the loop and real drones."""
