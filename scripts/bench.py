"""Set up .venv and score the packaged policy, and R1, on the smoke suite: `make bench`, on any system without make.

Usage: python3 scripts/bench.py (on Windows: python scripts/bench.py)
"""

from __future__ import annotations

import subprocess
import sys

import setup

SMOKE = "bench --suite open-v1:smoke --policy small --overwrite --out results/smoke"
R1 = "-r1 --reasoner small"


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(__doc__)
    setup.main()
    for more in ("", R1):
        command = [str(setup.PYTHON), "-m", "cognitivedrone", *f"{SMOKE}{more}".split()]
        if code := subprocess.run(command, cwd=setup.ROOT, check=False).returncode:
            sys.exit(code)
