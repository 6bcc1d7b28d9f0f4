"""Opens a LeRobot export with the real lerobot and checks what it says.

An environment of its own, because lerobot's pins conflict with ours, and a data set to open:

    python3.11 -m venv /tmp/lerobot && /tmp/lerobot/bin/pip install torch torchvision accelerate "datasets<5" \\
        "huggingface_hub<0.36" "packaging<26" pandas einops jsonlines draccus av torchcodec
    /tmp/lerobot/bin/pip install --no-deps lerobot==0.4.4
    cognitivedrone data export STORE --to lerobot --out OUT
    /tmp/lerobot/bin/python tests/external/check_lerobot.py OUT

Plain `pip install lerobot` does too, and takes more space. With video, torchcodec needs the libraries of FFmpeg.
It exits with an error at the first thing that is not as it should be.
"""

import json
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

KEY = "observation.images.front"
DOWN_KEY = "observation.images.down"
"""Only in exports of flights with a camera that looks down."""


def check_item(item: dict, record: dict) -> None:
    task = record["task"]
    assert item["task"] == task["prompt"]
    assert item["directive"] == task["prompt_simpler"]
    assert item["category"] == task["category"]
    assert item["family"] == task["family"]
    assert item["correct_gate"] == task["correct"]
    assert item["seed"] == record["conditions"]["seed"]
    for key in {KEY, DOWN_KEY} & item.keys():
        assert item[key].shape == (3, 256, 256)
        assert item[key].dtype == torch.float32
        assert 0 <= item[key].min() <= item[key].max() <= 1
    assert item[KEY].min() < item[KEY].max()
    assert item["action"].shape == (4,)
    assert item["action"].dtype == torch.float32
    assert item["observation.state"].shape == (5,)
    assert abs(float(item["position"][2] - item["observation.state"][3])) < 1e-5


def main(root: Path) -> None:
    data = LeRobotDataset("local/cognitivedrone", root=root)
    episodes = data.meta.episodes
    assert data.num_episodes == len(episodes) == data.meta.total_episodes
    assert len(data) == sum(episodes["length"]) == data.meta.total_frames
    for name in ("action", "observation.state", KEY):
        stats = data.meta.stats[name]
        assert (stats["min"] <= stats["q01"]).all(), name
        assert (stats["q01"] <= stats["q99"]).all(), name
        assert (stats["q99"] <= stats["max"]).all(), name
    for key in {KEY, DOWN_KEY} & data.meta.stats.keys():
        assert data.meta.stats[key]["mean"].shape == (3, 1, 1)
    actions = torch.tensor(np.array(data.hf_dataset.with_format("numpy")["action"]))
    assert np.allclose(actions.double().mean(0), data.meta.stats["action"]["mean"], atol=1e-5)

    rng = np.random.default_rng(0)
    for number in rng.permutation(len(episodes))[:100]:
        row = episodes[int(number)]
        record = json.loads(row["record"])
        for at in (row["dataset_from_index"], row["dataset_to_index"] - 1):
            item = data[at]
            assert item["episode_index"] == row["episode_index"]
            assert item["frame_index"] == at - row["dataset_from_index"]
            check_item(item, record)

    chunks = LeRobotDataset("local/cognitivedrone", root=root, delta_timestamps={"action": [0, 0.1, 0.2]})
    loader = torch.utils.data.DataLoader(chunks, batch_size=16, shuffle=True)
    start = time.perf_counter()
    batch = next(iter(loader))
    assert batch["action"].shape[1:] == (3, 4)
    assert len(batch["task"]) == len(batch["action"])
    print(f"{data.num_episodes} episodes, {len(data)} frames, splits {data.meta.info['splits']}")
    print(f"a shuffled batch of 16 with action chunks of 3: {time.perf_counter() - start:.2f} s")
    print(f"lerobot {version('lerobot')} opens {root}: all is as it should be")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
