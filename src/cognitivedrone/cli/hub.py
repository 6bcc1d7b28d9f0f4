"""Commands that share models and data sets: hub push, hub pull."""

from __future__ import annotations

from pathlib import Path

import tyro

from cognitivedrone.text.printable import visible


def push(
    folder: tyro.conf.Positional[Path], name: tyro.conf.Positional[str], public: bool = False, dry_run: bool = False
) -> None:
    """Upload a model or a data set to the Hugging Face Hub, as one commit.

    Models are folders with model.onnx, or eyes.onnx, gate_selector.onnx and language.onnx; data sets are what
    `collect` and `data export` (LeRobot, RLDS) write. The token is HF_TOKEN or that of `hf auth login`. Examples:

      cognitivedrone hub push runs/selector ME/my-reasoner --dry-run
      cognitivedrone hub push data/paper ME/my-flights --public

    Args:
        folder: The model or data set.
        name: Repository, as USER/NAME; made if there is none.
        public: Let everybody read a new repository; it is private otherwise.
        dry_run: List files and sizes, and send nothing.
    """
    from cognitivedrone.hub import contents_of, size_text

    if dry_run:
        shared = contents_of(folder)
        for each, size in shared.files.items():
            print(visible(f"{size_text(size):>9}  {each}"))  # noqa: T201
        total = f"{len(shared.files)} files, {size_text(shared.bytes)}"
        print(visible(f"a {shared.kind} of {total}; nothing was sent"))  # noqa: T201
        return
    from cognitivedrone.hub import push as send

    done = send(folder, name, public=public)
    print(visible(f"{done.endpoint}/{done.name}: a {done.kind}, revision {done.revision}"))  # noqa: T201


def pull(
    name: tyro.conf.Positional[str],
    folder: tyro.conf.Positional[Path],
    revision: str = "main",
    max_gb: float = 20.0,
) -> None:
    """Download a model or a data set of this package from the Hugging Face Hub.

    What is pulled is data: folders of another kind, and names of files that may hold code, are refused. The commit is
    recorded in FOLDER.hub.json, so that --revision can give the same again. Examples:

      cognitivedrone hub pull SOMEBODY/their-reasoner reasoner
      cognitivedrone hub pull datasets/SOMEBODY/flights data/flights --revision COMMIT

    Args:
        name: Repository, as USER/NAME, or datasets/USER/NAME.
        folder: New folder to write.
        revision: Branch, tag or commit.
        max_gb: Largest size, GB.
    """
    from cognitivedrone.hub import pull as fetch
    from cognitivedrone.hub import size_text

    done = fetch(name, folder, revision=revision, max_gb=max_gb)
    summary = f"{folder}: a {done.kind} of {done.files} files, {size_text(done.bytes)}, revision {done.revision}"
    print(visible(summary))  # noqa: T201
