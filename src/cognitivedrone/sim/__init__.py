"""The simulator: airframe, autopilot, batched flight, camera, referee. Knows stages, never tasks."""
