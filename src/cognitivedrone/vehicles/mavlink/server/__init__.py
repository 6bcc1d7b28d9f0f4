"""The simulator as a MAVLink vehicle, for ground stations and tests."""
