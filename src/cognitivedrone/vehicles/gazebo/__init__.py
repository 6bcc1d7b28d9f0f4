"""Gazebo: tasks as SDF worlds with an ArduPilot vehicle, checks with libsdformat, and a link to a running Gazebo.

Export, in `worlds/`: `sdf.py` builds worlds from a `Stage`, `meshes.py` writes meshes, `vehicle.py` is the Iris,
`export.py` writes the folder, `check.py` runs libsdformat. A running Gazebo: `live.py` swaps the gates by services that
`services.py` calls, `sensing.py` reads camera and poses, `flight.py` and `pilot.py` are the benchmark's drone,
`server.py` starts it. `selftest/` runs the checks of `checks.py` and `checks_in_flight.py`; `comparison.py` compares
pictures.
"""
