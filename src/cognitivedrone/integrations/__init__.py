"""The benchmark inside other people's harnesses: AllenAI's vla-eval, and LeRobot."""
