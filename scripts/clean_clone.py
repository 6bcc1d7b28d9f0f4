"""Run a command in a clean clone of HEAD, in a temporary folder that is removed afterwards. Standard library only.

Usage: python3 scripts/clean_clone.py COMMAND [ARGUMENT ...]

What is not committed is not in the clone, and it is said. Exits as the command does.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    command = sys.argv[1:]
    if not command or command[0].startswith("-"):
        sys.exit(__doc__)
    git = ["git", "-C", str(ROOT)]
    changed = subprocess.run([*git, "status", "--porcelain"], check=True, capture_output=True, text=True).stdout
    if changed:
        print(f"{len(changed.splitlines())} changed files are not committed, so they are not checked.", flush=True)
    with tempfile.TemporaryDirectory(prefix="cognitivedrone-clone-") as folder:
        clone = Path(folder) / "main"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
        subprocess.run(["git", "-C", str(clone), "checkout", "--quiet", "--detach", head], check=True)
        return subprocess.run(command, cwd=clone, stdin=subprocess.DEVNULL, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
