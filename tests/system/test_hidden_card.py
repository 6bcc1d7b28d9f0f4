"""The tests are the same with a graphics card as without one."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("card", "seen"), [("", ""), ("1", "0")])
def test_only_tests_of_a_card_see_one(card, seen, tmp_path):
    """conftest.py hides it before a test can import PyTorch, which looks for cards once."""
    program = f"""
import os, sys
sys.path.insert(0, {str(ROOT / "tests" / "support")!r})
import importlib.util
spec = importlib.util.spec_from_file_location("conftest", {str(ROOT / "tests" / "conftest.py")!r})
spec.loader.exec_module(importlib.util.module_from_spec(spec))
print("torch" in sys.modules, os.environ["CUDA_VISIBLE_DEVICES"])
"""
    environment = os.environ | {"CARD": card, "CUDA_VISIBLE_DEVICES": "0"}
    child = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert child.stdout.strip() == f"False {seen}".strip()


@pytest.mark.card
def test_a_card_is_there():
    torch = pytest.importorskip("torch")
    assert torch.cuda.is_available(), "make test-card is for machines with an NVIDIA graphics card"
