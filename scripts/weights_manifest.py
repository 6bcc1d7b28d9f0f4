"""The manifest of the packaged weights: recipe, steps, start, seed, commit, time and hash of each file.

Run: python scripts/weights_manifest.py           writes src/cognitivedrone/models/weights/manifest.json
     python scripts/weights_manifest.py --check   says whether it is up to date; exit code 1 if not

Everything but the seed stands in the files themselves, in the description that a training run writes.
"""

from __future__ import annotations

import json
import sys
from importlib import resources
from pathlib import Path
from typing import Any

import onnxruntime

from cognitivedrone.files import digest_of_file
from cognitivedrone.models.onnx_file import KEY

WEIGHTS = Path(str(resources.files("cognitivedrone.models") / "weights"))
MANIFEST = "manifest.json"
SEED = 0
"""Of all training runs whose weights are packaged."""


def manifest(folder: Path) -> str:
    """The manifest of a folder of model files, as the text of its file."""
    files = {path.relative_to(folder).as_posix(): entry(path) for path in sorted(folder.rglob("*.onnx"))}
    return json.dumps(files, indent=1) + "\n"


def entry(path: Path) -> dict[str, Any]:
    """What a model file says of its own training, and its hash."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    origin = json.loads(session.get_modelmeta().custom_metadata_map[KEY])["provenance"]
    told = {name: origin[name] for name in ("recipe", "steps", "data", "commit", "trained")}
    return {**told, "seed": SEED, "sha256": digest_of_file(path)}


def main(arguments: list[str]) -> int:
    """Write the manifest, or compare it."""
    if arguments not in ([], ["--check"]):
        sys.exit(__doc__)
    path, text = WEIGHTS / MANIFEST, manifest(WEIGHTS)
    if not arguments:
        path.write_text(text, encoding="utf-8")
        print(path)
        return 0
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return 0
    print(f"{path} is not of these weights; write it: python scripts/weights_manifest.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
