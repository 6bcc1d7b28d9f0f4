"""MAVLink: the client that flies a vehicle, and the server that is one."""
