"""The simulator: airframe, autopilot, batched flight, camera, gate monitor. Knows stages, never tasks."""
