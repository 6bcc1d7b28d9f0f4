"""What is said of the pictures of two renderers; here both are the processor, so nothing differs."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import rendering_difference

from cognitivedrone.benchmark.measurements import read_measurement


def test_the_same_renderer_draws_the_same_pictures(tmp_path, capsys):
    out = tmp_path / "difference.json"
    rendering_difference.main(["--rounds", "1", "--episodes", "0", "--choices", "cpu", "cpu", "--out", str(out)])
    (row,) = read_measurement(out).rows
    assert row["frames"] == rendering_difference.WORLDS
    assert row["largest"] == row["differ"] == row["flights"] == 0
    assert "llvmpipe" in row["renderers"][0]
    assert "a pixel differs by 0 of 255 at most" in capsys.readouterr().out


def test_what_differs_is_counted():
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    other = frames.copy()
    other[0, 0, 0] = (3, 0, 7)
    ends = np.array(["gate", "missed"])
    row = rendering_difference.difference(
        {"frames": frames, "ends": ends, "renderer": np.array("a")},
        {"frames": other, "ends": np.array(["gate", "gate"]), "renderer": np.array("b")},
    )
    assert row == {
        "renderers": ["a", "b"],
        "frames": 2,
        "largest": 7,
        "differ": 1 / 32,
        "flights": 2,
        "otherwise": 1,
    }
