"""Gazebo: tasks as SDF worlds with an ArduPilot vehicle, a check by libsdformat, and a link to a running Gazebo.

`sdf.py` builds worlds from a `Stage`, `meshes.py` writes our own meshes, `vehicle.py` is the Iris, `export.py` makes
a folder of it all, `check.py` asks libsdformat, `classic.py` reads the published collector's models. Of a running
Gazebo, `live.py` swaps the gates, `sight.py` sees and measures, `flight.py` and `pilot.py` are the benchmark's drone.
"""
