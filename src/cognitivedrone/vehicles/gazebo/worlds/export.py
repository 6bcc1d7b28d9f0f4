"""Exports a task or track as a folder for Gazebo: worlds, meshes, textures, ArduPilot's parameters and a README; and
checks SDF files with libsdformat, Gazebo's own parser.
"""

from __future__ import annotations

import ctypes.util
import functools
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from xml.etree import ElementTree as ET

import numpy as np
from PIL import Image as Pictures

from cognitivedrone.envs.track_runner import next_place, stage_of
from cognitivedrone.errors import GazeboError, TaskError, did_you_mean
from cognitivedrone.files import replace_file
from cognitivedrone.files.locks import holds_files, sole_writer
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import Suite, open_suite
from cognitivedrone.types import Image, Stage, Track
from cognitivedrone.vehicles.gazebo.bindings import Release, release_named
from cognitivedrone.vehicles.gazebo.worlds.sdf import (
    MATERIALS,
    MATERIALS_FILE,
    PanelPicture,
    Prop,
    document,
    obj_text,
    pattern_file,
    props_of,
    world,
    world_meshes,
)
from cognitivedrone.vehicles.gazebo.worlds.vehicle import iris, parameters
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import PATTERNS, PLAIN, Appearance, pattern_texture

PARAMETERS_FILE = "cognitivedrone.parm"
README_FILE = "README.md"


@dataclass(frozen=True, slots=True)
class Exported:
    """The files written."""

    out: Path
    worlds: tuple[Path, ...]
    """One for each stage, in order."""
    track: Track


def export(
    suite: str,
    *,
    tasks: Path | None = None,
    out: Path,
    task: str | None = None,
    track: str | None = None,
    version: str = "harmonic",
    labels: str = "open-v1",
    appearance: Appearance = PLAIN,
) -> Exported:
    """Write a task by id, or a track by number or by the id of one of its tasks, into a new folder.

    The tasks come from the suite or, if given, from the file or folder `tasks`; `labels` is a label pack or a folder of
    pictures. Raises `TaskError` or `LabelError` with similar names, `GazeboError` for an unknown release or a folder
    that cannot be written.
    """
    release = release_named(version)
    found = find_track(open_suite(suite, tasks), task=task, track=track)
    return write(found, out, load_pack(labels), release, appearance)


def find_track(suite: Suite, *, task: str | None = None, track: str | None = None) -> Track:
    """A task by id as a track of one, or a whole track by number (from 0) or by the id of one of its tasks.

    Raises `TaskError` with similar ids.
    """
    asked = task if track is None else track
    if asked is None or (task is not None and track is not None):
        raise TaskError("give --task ID for one task, or --track ID for all of a track; one of the two")
    if track is not None and track.isdecimal():
        if int(track) < len(suite.tracks):
            return suite.tracks[int(track)]
        raise TaskError(f"suite {suite.name!r} has no track {track}; it has 0 to {len(suite.tracks) - 1}")
    for found in suite.tracks:
        for one in found:
            if one.id == asked:
                return (one,) if track is None else found
    ids = [one.id for found in suite.tracks for one in found]
    raise TaskError(f"suite {suite.name!r} has no task {asked!r}; {did_you_mean(asked, ids)}")


def stages_of(track: Track) -> tuple[Stage, ...]:
    """The stages of a track, each behind the right gate of the previous one; the first at the world's origin."""
    stages: list[Stage] = []
    origin, yaw = (0.0, 0.0), 0.0
    for task in track:
        stage = stage_of(task, origin, yaw)
        stages.append(stage)
        origin, yaw = next_place(stage, task)
    return tuple(stages)


def write(track: Track, out: Path, labels: LabelPack, release: Release, appearance: Appearance = PLAIN) -> Exported:
    """Write a track into `out`, which must be new or empty; raises `GazeboError` if it cannot be written."""
    stages = stages_of(track)
    names = ["world.sdf"] if len(track) == 1 else [f"stage_{number}.sdf" for number in range(1, len(track) + 1)]
    try:
        if out.is_dir() and holds_files(out):
            raise GazeboError(f"{out} is not empty; give --out a new folder, or remove it first")
        with sole_writer(out, GazeboError, "exporting to it"):
            write_meshes(out)
            for stage, name in zip(stages, names, strict=True):
                props = write_pictures(stage, labels, appearance, out)
                replace_file(out / name, document(world_of(stage, props, appearance)).encode())
            replace_file(out / PARAMETERS_FILE, parameters().encode())
            replace_file(out / README_FILE, _readme(track, names, release).encode())
    except OSError as error:
        raise GazeboError(
            f"cannot write {error.filename or out}: {error.strerror or error};"
            " give --out a folder that you can write to"
        ) from None
    return Exported(out, tuple(out / name for name in names), track)


def world_of(stage: Stage, props: Sequence[Prop], appearance: Appearance = PLAIN) -> ET.Element:
    """The `<world>` of a stage, with the vehicle on the ground below the centre of its start box."""
    x, y = rotate_yaw(geometry.START[:2], stage.yaw) + np.array(stage.origin)
    return world(stage, props, appearance, iris((float(x), float(y)), stage.yaw, appearance))


def write_meshes(out: Path) -> None:
    """Write the meshes of every world into `out`/meshes."""
    folder = out / "meshes"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in _mesh_texts().items():
        replace_file(folder / f"{name}.obj", text.encode("ascii"))
    replace_file(folder / MATERIALS_FILE, MATERIALS.encode("ascii"))


def write_pictures(stage: Stage, labels: LabelPack, appearance: Appearance, out: Path) -> tuple[Prop, ...]:
    """Write the pictures of a stage's panels, floor and room to `out`/textures; returns its props."""
    folder = out / "textures"
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [_write_label(reference, labels.image(reference), folder) for reference in stage.labels]
    more = geometry.board_label(stage)
    board = None if more is None else _write_label(more, labels.image(more), folder)
    for pattern in PATTERNS:
        name = pattern_file(pattern)
        if name is not None and pattern in (appearance.floor_pattern, appearance.surroundings_pattern):
            Pictures.fromarray(pattern_texture(pattern)).save(folder / name)
    return props_of(stage, pictures, board, appearance)


def _write_label(reference: str, image: Image, folder: Path) -> PanelPicture:
    """Write a label as PNG, with a descriptive name that is unique to its pixels."""
    name = re.sub(r"[^a-z0-9]+", "_", reference.lower()).strip("_")[:40]
    digest = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).hexdigest()[:8]
    file = f"{name}_{digest}.png"
    if not (folder / file).exists():
        Pictures.fromarray(image).save(folder / file)
    return PanelPicture(file, image.shape[1] / image.shape[0])


@functools.cache
def _mesh_texts() -> dict[str, str]:
    return {name: obj_text(name, mesh) for name, mesh in world_meshes().items()}


def _readme(track: Track, names: Sequence[str], release: Release) -> str:
    text = resources.files(__package__).joinpath("export_readme.md").read_text(encoding="utf-8")
    cells = [task.instruction.replace("|", "\\|").replace("\n", " ") for task in track]
    rows = [f"| `{name}` | {task.id} | {cell} |" for name, task, cell in zip(names, track, cells, strict=True)]
    return Template(text).substitute(
        release=release.name.capitalize(),
        package=release.package,
        bindings=release.bindings,
        world=names[0],
        rows="\n".join(rows),
        parameters=PARAMETERS_FILE,
        build=release.name,
    )


COMMANDS = ("gz", "ign")
LIBRARIES = tuple(f"sdformat{major}" for major in range(16, 11, -1))
"""Library versions, from Jetty's to Debian 12's. Each exports `cmdCheck`, which the command line calls."""
PACKAGE = "libsdformat12-12"
_CALL = "import ctypes, sys; sys.exit(ctypes.CDLL(sys.argv[1]).cmdCheck(sys.argv[2].encode()) != 0)"
_UNKNOWN = "not defined in SDF"
_LIMIT_S = 60.0


@dataclass(frozen=True, slots=True)
class Checker:
    """A way to run libsdformat."""

    name: str
    command: tuple[str, ...]
    """Command line, without the file, which is the last argument."""


def find_checker() -> Checker | None:
    """The first checker available on this machine; none if there is none."""
    for library in LIBRARIES:
        found = ctypes.util.find_library(library)
        if found is not None:
            return Checker(found, (sys.executable, "-I", "-S", "-c", _CALL, found))
    for name in COMMANDS:
        found = shutil.which(name)
        if found is not None and _ran((found, "sdf", "--versions"), Path(os.devnull)).returncode == 0:
            return Checker(f"{name} sdf", (found, "sdf", "--check"))
    return None


def check(files: Sequence[Path]) -> str:
    """Check every file; returns the name of the checker.

    Raises `GazeboError` with the problem of the first file that does not pass, or if there is no checker.
    """
    checker = find_checker()
    if checker is None:
        raise GazeboError(f"libsdformat is not on this machine; install Gazebo, or: apt-get install {PACKAGE}")
    for file in files:
        if not file.is_file():
            raise GazeboError(f"there is no SDF file {file}; make one with: cognitivedrone gazebo export")
        problem = _problem(checker, file)
        if problem:
            raise GazeboError(f"{file} does not pass {checker.name}: {problem}")
    return checker.name


def _problem(checker: Checker, file: Path) -> str:
    """The parser's complaint about a file; empty if it passes.

    The parser skips unknown elements and mentions them only in the log that it writes into the home folder; here they
    are errors, too.
    """
    with TemporaryFolder("home") as home:
        done = _ran((*checker.command, str(file)), home)
        logs = [path.read_text(encoding="utf-8", errors="replace") for path in home.rglob("*.log")]
    output = done.stderr.strip()
    if done.returncode and not output:
        output = done.stdout.strip() or f"exit code {done.returncode}"
    unknown = [line for log in logs for line in log.splitlines() if _UNKNOWN in line]
    return " ".join((output or "\n".join(dict.fromkeys(unknown))).split())


def _ran(command: Sequence[str], home: Path) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(  # noqa: S603 - a fixed command, with the file as a single argument
            command,
            check=False,
            capture_output=True,
            text=True,
            timeout=_LIMIT_S,
            env={**os.environ, "HOME": str(home)},
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise GazeboError(f"cannot run {command[0]}: {error}; is libsdformat installed completely?") from None
