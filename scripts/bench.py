"""Set up .venv and score the packaged policy on the smoke suite: `make bench`, the same on every system without make.

Usage: python3 scripts/bench.py (on Windows: python scripts/bench.py)
"""

from __future__ import annotations

import subprocess
import sys

import setup

SMOKE = "bench --suite open-v1:smoke --policy small --out results/smoke --overwrite"


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(__doc__)
    setup.main()
    command = [str(setup.PYTHON), "-m", "cognitivedrone", *SMOKE.split()]
    sys.exit(subprocess.run(command, cwd=setup.ROOT, check=False).returncode)
