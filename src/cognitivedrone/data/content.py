"""The content of a shard, episode by episode: whether its frames can be shown and its numbers used."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from typing import Final

import numpy as np
from PIL import Image as PillowImage

from cognitivedrone.data.episode import Encoding, Episode
from cognitivedrone.data.shards import WIDTHS, ShardFile
from cognitivedrone.errors import DataError
from cognitivedrone.system import cores
from cognitivedrone.types import IMAGE_SIZE

START_M: Final = 1e-3
"""Largest distance between the first position and that of the conditions; there is none in flights of ours."""
STEP_M: Final = 1.0
"""Largest distance between the last position and the end of the flight, a step later; drones here reach 2.5 m/s."""
UNIT: Final = 1e-3
"""Largest difference between the norm of an attitude's quaternion and 1."""


def faults_of(shard: ShardFile) -> Iterator[str]:
    """What is wrong with the episodes of an open shard, at most one fault for each."""
    with ThreadPoolExecutor(cores()) as pool:
        for facts in shard.facts:
            where = f"episode {facts['index']}"
            try:
                episode = shard.episode(facts["index"])
            except DataError as error:
                yield f"{where}: {error}"
                continue
            steps = [f"frame {step}" for step in range(len(episode))]
            names = steps + [f"{step} of the camera that looks down" for step in steps if episode.down]
            frames = episode.images + episode.down
            checks = pool.map(_fault_of_frame, frames, [episode.encoding] * len(frames))
            frame = next((f"{name} {fault}" for name, fault in zip(names, checks, strict=True) if fault), None)
            if fault := _fault_of_numbers(episode) or frame:
                yield f"{where}: {fault}"


def _fault_of_numbers(episode: Episode) -> str | None:
    arrays = {name: getattr(episode, name) for name in (*WIDTHS, "final_position")}
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            return f"{name} holds a number that is not finite"
    if np.abs(np.linalg.norm(episode.quaternion, axis=1) - 1).max() > UNIT:
        return "quaternion holds one that is no rotation, whose norm is not 1"
    if np.linalg.norm(episode.position[0] - episode.conditions.start_position) > START_M:
        return "its positions do not begin where its conditions say; they are those of another flight"
    ours = episode.conditions.look != "published"
    if ours and np.linalg.norm(episode.final_position - episode.position[-1]) > STEP_M:
        return "its positions do not lead to its end; they are those of another flight"
    return None


def _fault_of_frame(data: bytes, encoding: Encoding) -> str | None:
    """Decodes the whole frame, once its header says that it has the size of ours."""
    try:
        with PillowImage.open(BytesIO(data), formats=("JPEG", "PNG", "WEBP")) as picture:
            if picture.size != (IMAGE_SIZE, IMAGE_SIZE):
                return f"has {picture.width} x {picture.height} pixels, not {IMAGE_SIZE} x {IMAGE_SIZE}"
            if (picture.format or "").lower() != encoding:
                return f"is {picture.format}, and the episode says {encoding}"
            picture.load()
    except PillowImage.DecompressionBombError:
        return f"has far more than {IMAGE_SIZE} x {IMAGE_SIZE} pixels"
    except Exception as error:  # Pillow raises many kinds for broken files
        return f"is no whole image ({' '.join(str(error).split())[:80] or type(error).__name__})"
    return None
