"""An ArduPilot vehicle flown over MAVLink."""
