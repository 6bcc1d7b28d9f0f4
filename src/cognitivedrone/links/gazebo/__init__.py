"""Gazebo: tasks as SDF worlds with an ArduPilot vehicle, a check by libsdformat, and a link to a running Gazebo.

`sdf.py` builds worlds from a `Stage`, `meshes.py` writes our own meshes, `vehicle.py` is the Iris, `export.py` makes
a folder of it all, `check.py` asks libsdformat, `live.py` swaps the gates of a running world and sees and measures.
"""
