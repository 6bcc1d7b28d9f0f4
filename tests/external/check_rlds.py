"""Opens an RLDS export with the real tensorflow-datasets and checks what it says.

An environment of its own, because TensorFlow's pins conflict with ours, and a data set to open:

    python3.11 -m venv /tmp/tfds && /tmp/tfds/bin/pip install tensorflow-cpu tensorflow-datasets
    cognitivedrone data export STORE --to rlds --out OUT
    /tmp/tfds/bin/python tests/external/check_rlds.py OUT

It exits with an error at the first thing that is not as it should be.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import tensorflow_datasets as tfds

DECODED = 100
"""Episodes of each split that are looked at step by step, with their pictures; the others are read undecoded."""


def check_features(folder: Path) -> None:
    """TFDS would have written the same features.json."""
    builder = tfds.builder_from_directory(folder)
    ours = json.loads((folder / "features.json").read_text())
    theirs = json.loads(json.dumps(json_of(builder.info.features)))
    assert ours == theirs, "features.json is not what tensorflow-datasets writes"


def json_of(features: Any) -> object:
    from google.protobuf import json_format

    return json_format.MessageToDict(features.to_proto())


def check_episode(episode: dict) -> int:
    metadata = {name: value.numpy() for name, value in episode["episode_metadata"].items()}
    task = json.loads(metadata["record"])["task"]
    assert metadata["directive"].decode() == task["prompt_simpler"]
    assert metadata["correct_gate"] == task["correct"]
    assert metadata["family"].decode() == task["family"]
    assert metadata["category"].decode() == task["category"]
    steps = list(episode["steps"].as_numpy_iterator())
    for number, step in enumerate(steps):
        last = number == len(steps) - 1
        cameras = {"image", "image_down"} & step["observation"].keys()
        for name in cameras:
            assert step["observation"][name].shape == (256, 256, 3)
            assert step["observation"][name].dtype == np.uint8
        assert step["observation"]["image"].std() > 0
        assert step["observation"]["state"].shape == (5,)
        assert step["action"].shape == (4,)
        assert step["action"].dtype == np.float32
        assert step["language_instruction"].decode() == task["prompt"]
        assert step["recorded"]["position"].dtype == np.float64
        assert abs(step["recorded"]["position"][2] - step["observation"]["state"][3]) < 1e-5
        assert abs(np.linalg.norm(step["recorded"]["quaternion"]) - 1) < 1e-9
        flags = bool(step["is_first"]), bool(step["is_last"]), bool(step["is_terminal"])
        assert flags == (number == 0, last, last)
        assert (step["reward"], step["discount"]) == (float(last), 1.0)
    return len(steps)


def count_undecoded(builder: tfds.core.DatasetBuilder, split: str) -> tuple[int, set[int], set[str]]:
    """Steps, indices and families of all episodes, read as loaders such as OpenVLA's do: pictures stay encoded."""
    steps, indices, families = 0, set(), set()
    for episode in builder.as_dataset(split=split, decoders={"steps": tfds.decode.SkipDecoding()}):
        batch, metadata = episode["steps"], episode["episode_metadata"]
        length = batch["action"].shape[0]
        assert batch["action"].shape == (length, 4)
        assert batch["observation"]["image"].shape == (length,)
        assert batch["language_instruction"].shape == (length,)
        assert np.isfinite(batch["action"]).all()
        steps += length
        indices.add(int(metadata["index"]))
        families.add(metadata["family"].numpy().decode())
    return steps, indices, families


def main(out: Path) -> None:
    folder = out / "cognitivedrone" / "1.0.0"
    check_features(folder)
    by_name = tfds.builder("cognitivedrone", data_dir=out)
    assert set(by_name.info.splits) <= {"train", "val"}
    seen: set[int] = set()
    for split, info in tfds.builder_from_directory(folder).info.splits.items():
        start = time.perf_counter()
        for episode in by_name.as_dataset(split=split).take(DECODED):
            check_episode(episode)
        steps, indices, families = count_undecoded(by_name, split)
        assert len(indices) == info.num_examples, "an episode is missing or comes twice"
        assert not indices & seen, "an episode is in both splits"
        seen |= indices
        seconds = time.perf_counter() - start
        print(f"{split}: {len(indices)} episodes, {steps} steps, {len(families)} families, {seconds:.1f} s")
    print(f"tensorflow-datasets {tfds.__version__} opens {folder}: all is as it should be")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
