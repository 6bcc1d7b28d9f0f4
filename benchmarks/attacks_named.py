"""Attacks by names: code, files and servers that a file or an argument names, bad values, and a poisoned folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from attack_tools import MARK, PROJECT, Attack, command, each, refused, traces, why_not_refused

SMOKE = ("--suite", "open-v1:smoke", "--episodes", "1", "--workers", "0", "--clips", "0")
CALLS = (
    f"os:system:touch {MARK}",
    f"os:mkdir:{MARK}",
    f"subprocess:Popen:touch {MARK}",
    f"subprocess:run:touch {MARK}",
    f"subprocess:getoutput:touch {MARK}",
    f"builtins:exec:open('{MARK}','w')",
    f"builtins:eval:open('{MARK}','w')",
    f"shutil:copy:../secret.txt,{MARK}",
    f"pathlib:Path.touch:{MARK}",
    "cognitivedrone.cli:main",
)
"""What runs a command or makes a file, where a policy or reasoner is expected."""
PLACES = {
    "policy": (
        "remote:ws://127.0.0.1:9",
        "remote",
        "small:../secret.txt",
        "race:/dev/zero",
        "openvla:..",
        "lerobot:..",
    ),
    "reasoner": ("replay:../secret.txt", "vlm:http://127.0.0.1:9/v1", "vlm", "remote:ws://127.0.0.1:9", "vlm-local"),
}
"""The package's own names for files and servers."""
MODULES = ("multiprocessing", "json", "numpy", "mujoco", "ctypes", "socket", "cognitivedrone", "sitecustomize")
"""Modules that Python would take from the current folder."""
WHOLE_COMMAND_S = 600
"""A command that does its work may take that long, on a busy machine."""
IN_POISONED_FOLDERS = (
    "bench --policy hover --suite open-v1:smoke --episodes 1 --workers 1 --clips 0 --out run",
    "list",
    "view --suite open-v1:smoke --episode 1 --out view.png",
    "collect --policy oracle --suite open-v1:smoke --episodes 1 --workers 1 --out set",
    "reason --reasoner small --suite open-v1:smoke --episodes 1 --out reasons",
    f"verify {PROJECT}/leaderboard/race.json --sample 1",
)
"""Commands that start Python processes, or load much."""
BAD_VALUES: Mapping[str, tuple[object, ...]] = {
    "bench, no episodes": ("bench", *SMOKE, "--episodes", "0"),
    "bench, episodes below 0": ("bench", *SMOKE, "--episodes", "-5"),
    "bench, workers below 0": ("bench", *SMOKE, "--workers", "-1"),
    "bench, wind that is no number": ("bench", *SMOKE, "--wind", "nan"),
    "bench, infinite wind": ("bench", *SMOKE, "--wind", "inf"),
    "bench, wind below 0": ("bench", *SMOKE, "--wind", "-1"),
    "bench, shard 0/0": ("bench", *SMOKE, "--shard", "0/0"),
    "bench, shard 3/2": ("bench", *SMOKE, "--shard", "3/2"),
    "bench, shard 1/10^9": ("bench", *SMOKE, "--shard", "1/1000000000"),
    "bench, timeout that is no number": ("bench", *SMOKE, "--decision-timeout", "nan"),
    "bench, latency below 0": ("bench", *SMOKE, "--latency", "policy=-5ms"),
    "bench, latency of a day": ("bench", *SMOKE, "--latency", "policy=86400s"),
    "bench, latency from a folder": ("bench", *SMOKE, "--latency", "policy=/tmp"),
    "bench, latency from a device": ("bench", *SMOKE, "--latency", "policy=/dev/zero"),
    "bench, unknown suite": ("bench", "--suite", "../../etc/passwd"),
    "bench, suite with an escape": ("bench", "--suite", "open\x1b[2J"),
    "bench, unknown airframe": ("bench", *SMOKE, "--airframe", "../x"),
    "bench, labels that are no folder": ("bench", *SMOKE, "--labels", "/dev/zero"),
    "bench, tasks that are a device": ("bench", "--tasks", "/dev/zero", "--workers", "0"),
    "bench, a real vehicle": ("bench", *SMOKE, "--link", "mavlink:udp:127.0.0.1:14550"),
    "bench, policy of 10,000 characters": ("bench", *SMOKE, "--policy", "x" * 10_000),
    "bench, policy with an escape": ("bench", *SMOKE, "--policy", "a\x1b[31mb"),
    "bench, policy with a surrogate": ("bench", *SMOKE, "--policy", "a\ud800"),
    "bench, out below a file": ("bench", *SMOKE, "--out", "/dev/null/x"),
    "verify, sample 0": ("verify", PROJECT / "leaderboard" / "race.json", "--sample", "0"),
    "verify, seed below 0": ("verify", PROJECT / "leaderboard" / "race.json", "--seed", "-1"),
    "view, episode below 0": ("view", "--episode", "-1"),
    "view, episode 10^9": ("view", "--suite", "open-v1:smoke", "--episode", "1000000000"),
    "data replay, no data set": ("data", "replay", "..", "0"),
    "fly, empty link": ("fly", "--link", ""),
    "collect, beta that is no number": ("collect", "--out", "set", "--beta", "nan"),
    "submit, name with a line break": ("submit", "x", "--name", "a\nb", "--by", "c", "--out", "x.json"),
    "submit, javascript: as url": (
        "submit",
        "--name",
        "a",
        "--by",
        "b",
        "--url",
        "javascript:x",
        "--out",
        "x.json",
        "x",
    ),
}


def attacks(submission: Mapping[str, Any]) -> list[Attack]:
    """All of them; `submission` is the content of an honest file."""
    return [
        *each("code named by a file", {**dict(_named(submission)), **dict(_options(submission))}),
        *each("code named on the command line", dict(_typed())),
        *each("bad values", {name: refused(*words) for name, words in BAD_VALUES.items()}),
        *[Attack("poisoned folder", name, run, WHOLE_COMMAND_S) for name, run in _poisoned()],
    ]


def _named(submission: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[Path], str]]]:
    """A submission whose policy or reasoner is code, a file or a server."""
    for part, places in PLACES.items():
        for name in (*CALLS, *places, "mine:Policy", "mine:Policy:x"):
            yield f"{part} {name}", _verified(submission, {part: name}, says="which must not choose")


def _options(submission: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[Path], str]]]:
    for name, options in {
        "latency from a file": {"latency": "policy=../secret.txt"},
        "latency from a device": {"latency": "reasoner=/dev/zero"},
        "link to a vehicle": {"link": "mavlink:udp:127.0.0.1:14550"},
        "link to Gazebo": {"link": "gazebo"},
        "link to a program": {"link": "sitl"},
        "label pictures": {"labels": "0" * 64},
    }.items():
        yield name, _verified(submission, {}, options)


def _verified(
    submission: Mapping[str, Any], pilot: Mapping[str, str], options: Mapping[str, Any] | None = None, says: str = ""
) -> Callable[[Path], str]:
    def run(folder: Path) -> str:
        (folder / "mine.py").write_text(f"open('{MARK}', 'w').close()\nclass Policy: ...\n")
        sys.path.insert(0, str(folder))
        try:
            document = json.loads(json.dumps(submission))
            for each_run in document["runs"]:
                each_run["run"] |= pilot
                each_run["run"]["options"] |= options or {}
            (folder / "file.json").write_text(json.dumps(document))
            return why_not_refused(command("verify", "file.json", "--sample", 1), says)
        finally:
            sys.path.remove(str(folder))
            sys.modules.pop("mine", None)

    return run


def _typed() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Code that is no policy where a person names one by mistake, or pastes a line of somebody else's."""
    for name in CALLS:
        yield f"bench --policy {name}", refused("bench", *SMOKE, "--policy", name)
    name = CALLS[0]
    yield "bench --reasoner", refused("bench", *SMOKE, "--policy", "hover", "--reasoner", name)
    yield "serve --policy", refused("serve", "--policy", name, "--port", 0)
    yield "serve --reasoner", refused("serve", "--policy", "hover", "--reasoner", name, "--port", 0)
    yield "collect --policy", refused("collect", "--out", "set", "--episodes", 1, "--policy", name)
    yield "reason --reasoner", refused("reason", "--suite", "open-v1:smoke", "--episodes", 1, "--reasoner", name)
    yield "audit --policy", refused("audit", "--policy", name, "--episodes", 1, "--workers", 0)
    yield "fly --policy", refused("fly", "to the bird", "--policy", name)
    yield "verify --policy", refused("verify", PROJECT / "leaderboard" / "race.json", "--policy", name)
    yield "data import --from", refused("data", "import", ".", "--from", "os:system", "--out", "set")


def _poisoned() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """The command in a folder with modules of somebody else: in it and in the processes that it starts."""
    for module in MODULES:
        yield f"{module}.py in the current folder", _in_poisoned_folder([module], IN_POISONED_FOLDERS[0])
    for words in IN_POISONED_FOLDERS:
        yield f"all of them, {words.partition(' -')[0]}", _in_poisoned_folder(MODULES, words)


def _in_poisoned_folder(modules: Sequence[str], words: str) -> Callable[[Path], str]:
    def run(folder: Path) -> str:
        for module in modules:
            (folder / f"{module}.py").write_text(f"open('{MARK}', 'w').close()\n")
        script = Path(sys.executable).with_name("cognitivedrone")
        clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONSAFEPATH")}
        done = subprocess.run([script, *words.split()], env=clean, capture_output=True, text=True, check=False)
        if fell := traces(folder.parent):
            return fell
        return "" if done.returncode == 0 else f"exit code {done.returncode}: {done.stderr[-200:]!r}"

    return run
