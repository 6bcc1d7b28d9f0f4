"""A checkout with the form of the published benchmark, made small from our own tasks and pictures.

All eight validation files by their published names, the training file with `gates` as a dict, type folders of COLLADA
panels whose pictures are spelt otherwise, and recorded flights below folders with colons in their names. What is asked
and shown in it is ours.
"""

import csv
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from cognitivedrone.collect.collector import collect
from cognitivedrone.collect.config import CollectPlan
from cognitivedrone.data.formats import export
from cognitivedrone.data.store import Store
from cognitivedrone.labels import load_pack

COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <library_effects><effect id="e"><profile_COMMON>
    <newparam sid="s"><surface type="2D"><init_from>shown</init_from></surface></newparam>
  </profile_COMMON></effect></library_effects>
  <library_images><image id="shown"><init_from>{picture}</init_from></image></library_images>
</COLLADA>
"""
WORDS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
PERSON = "person/hat={hat},glasses={glasses},hair={hair}"
PANELS: dict[str, dict[str, str]] = {
    "Human Recognition/Celebrities": {
        "Ada_Red": "person/hat=hat,hat_color=red", "bob_glasses": "person/glasses=glasses,hair=short",
        "Cleo_Bald": "person/hair=bald,beard=full",
    },
    "Human Recognition/Patterns": {
        "a_hat": "person/hat=hat", "a_beard": "person/beard=full", "glasses": "person/glasses=round",
    },
    "Reasoning/Letters": {letter: f"letter/{letter}" for letter in "TKZ"},
    "Reasoning/Digits": {WORDS[n]: f"number/{n}" for n in (1, 2, 4, 7)},
    "Reasoning/Animals": {
        "fox": "animal/fox", "owl": "animal/owl", "cheetah": "animal/tiger", "whale": "animal/whale"
    },
    "Reasoning/Logos": {name: f"logo/{name}" for name in ("apple", "amazon", "netflix")},
    "Reasoning/Food": {
        "Healthy/healthy_1": "food/apple", "Unhealthy/unhealthy_1": "food/burger", "Unhealthy/unhealthy_2": "food/donut"
    },
}  # fmt: skip
"""Type folder to option to what our pack draws for it."""
VALIDATION: dict[str, tuple[str, str, Sequence[str]]] = {
    "Celebrities_valid": ("Human Recognition/Celebrities", "Fly through the gate with {}", ()),
    "Patterns_valid": ("Human Recognition/Patterns", "Fly through the gate with a person with {}", ()),
    "letters_validation": ("Reasoning/Letters", "Fly through the gate with a letter {}", ()),
    "validation_digit": ("Reasoning/Digits", "Fly through the gate with {}", ("one", "two", "four")),
    "validation_animal": ("Reasoning/Animals", "Fly through the gate with a {}", ("fox", "owl", "cheetah")),
    "validation_logo": ("Reasoning/Logos", "Fly through the gate with {}", ()),
    "validation_food": ("Reasoning/Food", "Fly to the gate with healthy food", ()),
    "Math_prompt_valid": ("Reasoning/Digits", "Fly through the gate with number equal 3+4", ("seven", "two", "four")),
}
GROUPS = {"Human Recognition": "Validation_human/Validation", "Reasoning": "Validation_reasoning/Validation"}
_LOOKS = (("big", "round", "red"), ("small", "square", "green"), ("big", "triangle", "blue"))


def published_task(options: Sequence[str], correct: int, prompt: str, *, listed: bool = True) -> dict[str, Any]:
    """A task in the published layout; `listed` gates as in its validation files, else as in those for training."""
    gates = {
        str(number): dict(zip(("size", "shape", "color"), look, strict=True)) for number, look in enumerate(_LOOKS, 1)
    }
    size, shape, color = _LOOKS[correct - 1]
    return {
        "prompt": prompt,
        "prompt_simpler": f"Fly through the {size} {shape} {color} gate",
        "options": [f"{option}.dae" for option in options],
        "correct": correct,
        "gates": [{"gate": number, **gate} for number, gate in gates.items()] if listed else gates,
        "background": "room",
    }


def tasks_of(name: str, *, listed: bool = True) -> list[dict[str, Any]]:
    """Three tasks of a validation file, or as many where another gate would be wrong."""
    folder, prompt, options = VALIDATION[name]
    options = options or tuple(PANELS[folder])
    fixed = "{}" not in prompt  # the first option is the right one
    made = []
    for turn in range(3):
        turned = [options[(place + turn) % 3] for place in range(3)]
        right = turned.index(options[0]) if fixed else turn
        said = prompt.format(turned[right].replace("_", " "))
        made.append(published_task(turned, right + 1, said, listed=listed))
    return made


def make_checkout(root: Path) -> Path:
    """Write the checkout without recorded flights; returns its folder."""
    pack = load_pack()
    models = root / "model_for_data_collection"
    for folder, panels in PANELS.items():
        for option, reference in panels.items():
            panel = models / folder / option
            panel.parent.mkdir(parents=True, exist_ok=True)
            stored, model = panel.with_suffix(".jpg"), panel.with_suffix(".dae")
            if option == "cheetah":
                stored, model = panel.with_name("cheetahdae.jpg"), panel.with_name("cheetahdae.dae")
            elif option == "owl":
                stored = panel.with_name("Great Owl.png")  # another name, which only its model tells
            elif option == "bob_glasses":
                stored, model = panel.with_name("Bob_Glasses.jpg"), panel.with_name("BOB_glasses.dae")
            Image.fromarray(pack.image(reference)).save(stored)
            model.write_text(COLLADA.format(picture=stored.name.replace(" ", "%20")))
    (root / "Validation").mkdir()
    for name, (folder, _, _) in VALIDATION.items():
        write(root / "Validation" / f"{name}.json", tasks_of(name))
        stem = "math_prompt" if name.startswith("Math") else f"{folder.rpartition('/')[2]}"
        place = root / "Validation" if name.startswith("Math") else (models / folder).parent
        write(place / f"{stem}.json", tasks_of(name, listed=False)[:2])
        answers = root / "eval_after_reasoning/after_reasoning" / f"{stem.removesuffix('.json')}_updated.json"
        answers.parent.mkdir(parents=True, exist_ok=True)
        write(answers, [
            {**task, "reasoning": "The panel of the gate shows it.", "prompt_after_reasoning": task["prompt_simpler"]}
            for task in reversed(tasks_of(name))
        ])  # fmt: skip
    return root


def add_flights(root: Path, exported: Path) -> None:
    """Move flights of our published export below the checkout's Validation folder, without what only ours have."""
    for number, setup_path in enumerate(sorted(exported.glob("*/*/setup.json"))):
        setup = json.loads(setup_path.read_text())
        name = setup["id"].partition("/")[0]
        group = GROUPS[VALIDATION[name][0].partition("/")[0]]
        folder = root / "Validation" / group / name / f"2025-02-28 12:12:{number:02}.747449"
        folder.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(setup_path.parent, folder)
        gates = setup["gates"]
        keys = ("prompt", "prompt_simpler", "options", "correct", "background")
        listed = [{"gate": gate, **gates[gate]} for gate in "123"]
        write(folder / "setup.json", {key: setup[key] for key in keys} | {"gates": listed})


def make_checkout_with_flights(folder: Path) -> None:
    """`folder/checkout` with eight recorded flights, one of each validation file, flown by the expert."""
    root = folder / "checkout"
    root.mkdir()
    make_checkout(root)
    config = CollectPlan.of(
        out=folder / "store", recipe="debug", tasks=root / "Validation", labels=root, episodes=24, workers=1
    )
    collect(config, progress=False)
    flights = (pair for pair in Store.open(folder / "store").labelled() if pair[1].task.id.endswith("/0001"))
    export(flights, "published", folder / "exported")
    add_flights(root, folder / "exported")


def turn_to_gate(folder: Path, gate: tuple[float, float]) -> None:
    """Write a flight's angles as if another gate, m, were the right one."""
    rows = list(csv.reader((folder / "data.csv").read_text().splitlines()))
    poses = np.array([[float(cell) for cell in row[5:]] for row in rows[1:]])
    for number, row in enumerate(rows[1:]):
        x, y, z, w = poses[number, 3:]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        ahead = poses[min(number + 3, len(poses) - 1)]
        turn = np.arctan2(gate[1] - ahead[1], gate[0] - ahead[0]) - yaw
        row[4] = repr(float((turn + np.pi) % (2 * np.pi) - np.pi))
    (folder / "data.csv").write_text("".join(",".join(row) + "\n" for row in rows))


def write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))
