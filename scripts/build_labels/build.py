"""Rebuild the shipped label pack from the packages that its drawings and fonts come in.

    python scripts/build_labels/build.py --work FOLDER

needs Node.js with npm, and the Python packages of `requirements.txt`. The npm packages of `package.json` are
installed under FOLDER; everything is pinned, so the same files come out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import fonts
import people
import pictures

PACK = Path(__file__).resolve().parents[2] / "src/cognitivedrone/labels/packs/open-v1"
HERE = Path(__file__).resolve().parent

SETS = {
    "@iconify-json/noto": ("Noto Emoji", "Google", "Apache-2.0", "animals, foods and objects @noto"),
    "@iconify-json/twemoji": (
        "Twemoji",
        "Twitter and contributors",
        "CC-BY-4.0",
        "animals, foods and objects @twemoji",
    ),
    "@iconify-json/fluent-emoji-flat": ("Fluent Emoji", "Microsoft", "MIT", "animals, foods and objects @fluent"),
    "@iconify-json/openmoji": ("OpenMoji", "OpenMoji", "CC-BY-SA-4.0", "animals, foods and objects @openmoji"),
    "@iconify-json/logos": ("SVG Logos", "Gil Barbara", "CC0-1.0", "logos"),
    "simple-icons": ("Simple Icons", "Simple Icons Collaborators", "CC0-1.0", "logos"),
    "@dicebear/avataaars": ("Avataaars", "Pablo Stanley", "Free for personal and commercial use", "people"),
}
"""npm package: name, author, licence, what it is used for."""
SET_LICENCES = {"@dicebear/avataaars": "LICENSE", "simple-icons": "LICENSE.md"}
"""Licence files that the packages bring along."""


def main() -> None:
    """Install the sources, draw everything, write the manifest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="folder for the npm packages")
    work: Path = parser.parse_args().work
    work.mkdir(parents=True, exist_ok=True)
    shutil.copy(HERE / "package.json", work)
    subprocess.run(["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts"], cwd=work, check=True)
    modules = work / "node_modules"
    versions = json.loads((HERE / "package.json").read_text(encoding="utf-8"))["dependencies"]

    for folder in ("fonts", "pictures", "people", "licences"):
        shutil.rmtree(PACK / folder, ignore_errors=True)
    files: dict[str, str] = {}

    def write(path: str, content: bytes) -> None:
        target = PACK / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
        files[path] = hashlib.sha256(content).hexdigest()

    for name, content in fonts.fonts(modules):
        write(f"fonts/{name}.ttf", content)
    for name, content in pictures.pictures(modules):
        write(f"pictures/{name}.webp", content)
    offsets: dict[str, tuple[int, int]] = {}
    for layer in people.layers(work):
        write(f"people/{layer.name}.webp", pictures.encode(layer.image, lossy=False))
        offsets[layer.name] = layer.offset

    sources = []
    for package, version in versions.items():
        if package == "@dicebear/core":  # the machinery of the people's package, no drawing of it is used
            continue
        if package.startswith("@fontsource/"):
            source = font_source(modules / package)
            licence_file = modules / package / "LICENSE"
        else:
            name, author, licence, used_for = SETS[package]
            source = {"name": name, "author": author, "licence": licence, "used_for": used_for}
            licence_file = modules / package / SET_LICENCES.get(package, "no such file")
        if licence_file.exists():
            source["licence_file"] = f"licences/{package.rpartition('/')[2]}.txt"
            write(source["licence_file"], licence_file.read_bytes())
        else:
            source["licence_file"] = f"licences/{source['licence']}.txt"
            write(source["licence_file"], licence_text(source["licence"], modules))
        sources.append({"package": f"npm:{package}", "version": version, **source})

    manifest = {
        "name": "open-v1",
        "fonts": [*fonts.TRAIN, *fonts.HELD_OUT],
        "styles": list(pictures.STYLES),
        "sources": sources,
        "people": offsets,
        "files": dict(sorted(files.items())),
    }
    (PACK / "manifest.json").write_text(json.dumps(manifest, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    size = sum((PACK / path).stat().st_size for path in files)
    print(f"{len(files)} files, {size / 1e6:.2f} MB")


def licence_text(licence: str, modules: Path) -> bytes:
    """Licence and credit of a set whose package brings no file: ours beside this script, the Apache text of a font."""
    if licence == "Apache-2.0":
        return (modules / "@fontsource/roboto-slab/LICENSE").read_bytes()
    return (HERE / "licences" / f"{licence}.txt").read_bytes()


def font_source(package: Path) -> dict[str, str]:
    """What a font's package says of itself."""
    metadata = json.loads((package / "metadata.json").read_text(encoding="utf-8"))
    return {
        "name": metadata["family"],
        "author": metadata["license"]["attribution"],
        "licence": metadata["license"]["type"],
        "used_for": f"letters, numbers and sums @{metadata['id']}",
    }


if __name__ == "__main__":
    main()
