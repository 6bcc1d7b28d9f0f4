"""Makes the vehicles that play a part importable by their names."""

import sys
from pathlib import Path

for folder in ("apps", "vehicles", "vehicles/gazebo"):
    sys.path.insert(0, str(Path(__file__).parents[1] / folder))
