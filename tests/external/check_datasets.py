"""Opens a LeRobot export as a plain data set of Hugging Face's `datasets`, without LeRobot, and checks what it says.

An environment of its own, and a data set to open:

    python3.11 -m venv /tmp/datasets && /tmp/datasets/bin/pip install datasets pillow
    cognitivedrone data export STORE --to lerobot --out OUT
    /tmp/datasets/bin/python tests/external/check_datasets.py OUT

It exits with an error at the first thing that is not as it should be.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import datasets
from datasets import Features, Image, Value, load_dataset

KEY = "observation.images.front"
DOWN_KEY = "observation.images.down"
"""Only in exports of flights with a camera that looks down."""


def main(root: Path) -> None:
    info = json.loads((root / "meta/info.json").read_text("utf-8"))
    with tempfile.TemporaryDirectory() as cache:
        whole = load_dataset(str(root), cache_dir=cache)
        files = load_dataset("parquet", data_files=str(root / "data/*/*.parquet"), cache_dir=cache)["train"]
        assert list(whole) == list(info["splits"])
        assert sum(map(len, whole.values())) == len(files) == info["total_frames"]
        for split, steps in whole.items():
            first, stop = map(int, info["splits"][split].split(":"))
            assert set(steps["episode_index"]) == set(range(first, stop)), split
            assert steps.features == files.features
            assert list(steps.features) == list(info["features"])
            for key in {KEY, DOWN_KEY} & steps.features.keys():
                assert isinstance(steps.features[key], Image)
                assert steps[0][key].size == (256, 256)
            assert len(steps[0]["action"]) == 4
        # As LeRobot reads the files: with features of its own making.
        wanted = Features({**files.features, "timestamp": Value("float32")})
        paths = sorted(str(path) for path in root.glob("data/*/*.parquet"))
        again = datasets.Dataset.from_parquet(paths, features=wanted, cache_dir=cache)
        assert len(again) == info["total_frames"]
    print(f"datasets {datasets.__version__} opens {root}: all is as it should be")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
