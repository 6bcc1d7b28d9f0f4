"""Python environments of their own, for other projects' clients whose dependencies conflict with ours."""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

FOLDER = "COGNITIVEDRONE_TEST_ENVIRONMENTS"
"""Environment variable: where the environments are kept; by default in pytest's cache."""
INSTALL_S = 300


def python_with(config: pytest.Config, *packages: str) -> Path:
    """The interpreter of an environment with these packages, made the first time; skips the test if that fails."""
    cache = getattr(config, "cache", None)  # none with -p no:cacheprovider
    kept = Path(os.environ.get(FOLDER) or (cache.mkdir("environments") if cache else tempfile.mkdtemp()))
    name = "-".join(package.partition("=")[0] for package in packages)
    digest = hashlib.sha256(f"{sys.version} {packages}".encode()).hexdigest()[:8]
    made = kept / f"{name}-{digest}"
    python = made / "bin" / "python"
    if python.is_file():
        return python
    kept.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(dir=kept))
    try:
        subprocess.run([sys.executable, "-m", "venv", "--copies", str(part)], check=True, capture_output=True)
        subprocess.run(
            [str(part / "bin" / "python"), "-m", "pip", "install", "--quiet", *packages], check=True,
            capture_output=True, text=True, timeout=INSTALL_S,
            env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        )  # fmt: skip
        if not python.is_file():
            part.rename(made)
    except (subprocess.SubprocessError, OSError) as error:
        shutil.rmtree(part, ignore_errors=True)
        last = (str(getattr(error, "stderr", "") or error).strip().splitlines() or [type(error).__name__])[-1]
        pytest.skip(f"{' '.join(packages)} cannot be installed here: {last[:200]}")
    return python
