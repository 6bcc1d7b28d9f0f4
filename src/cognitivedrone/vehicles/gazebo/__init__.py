"""Gazebo: tasks as SDF worlds with an ArduPilot vehicle, checks with libsdformat, and a link to a running Gazebo.

Export, in `worlds/`: `sdf.py` builds worlds from a `Stage`, with their meshes, `vehicle.py` is the Iris, `export.py`
writes the folder and runs libsdformat. A running Gazebo: `live.py` swaps the gates by services that `bindings.py` calls
in a process of its own, `sensing.py` reads camera and poses, `flight.py` is the benchmark's drone.
"""
