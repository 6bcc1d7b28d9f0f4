"""Statistics of a LeRobot data set: min, max, mean, std, count and quantiles per feature, per episode and overall.

Numbers are exact. Pictures are sampled, as in LeRobot: a few frames per episode, every fourth pixel in each direction,
accumulated in one histogram per channel, which gives exact quantiles of the sample in constant memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import decode_image

Stats = dict[str, list[Any]]

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
FRAMES_AN_EPISODE = 4
PIXEL_STRIDE = 4


class Statistics:
    """Accumulates episodes; `total` covers all of them."""

    def __init__(self) -> None:
        self._columns: dict[str, list[NDArray[Any]]] = {}
        self._histograms: dict[str, NDArray[np.int64]] = {}
        self._frames = 0

    def add(self, numbers: Mapping[str, NDArray[Any]], cameras: Mapping[str, tuple[bytes, ...]]) -> dict[str, Stats]:
        """Add the step arrays (T, ...) and each camera's T frames of an episode; returns its own statistics."""
        for name, values in numbers.items():
            self._columns.setdefault(name, []).append(values)
        stats = {name: number_stats(values) for name, values in numbers.items()}
        length = len(next(iter(cameras.values())))
        sampled = np.unique(np.linspace(0, length - 1, FRAMES_AN_EPISODE).astype(int)).tolist()
        self._frames += len(sampled)
        for key, images in cameras.items():
            histogram = sum((_histogram(images[step]) for step in sampled), np.zeros((3, 256), np.int64))
            self._histograms[key] = self._histograms.get(key, 0) + histogram
            stats[key] = image_stats(histogram, len(sampled))
        return stats

    def total(self) -> dict[str, Stats]:
        """Statistics of all added episodes."""
        stats = {name: number_stats(np.concatenate(parts)) for name, parts in self._columns.items()}
        return stats | {key: image_stats(histogram, self._frames) for key, histogram in self._histograms.items()}


def number_stats(values: NDArray[Any]) -> Stats:
    """Statistics of (T,) or (T, n) numbers, each a list of n (of one for scalars)."""
    table = values.reshape(len(values), -1).astype(np.float64)
    stats: Stats = {
        "min": table.min(0).tolist(),
        "max": table.max(0).tolist(),
        "mean": table.mean(0).tolist(),
        "std": table.std(0).tolist(),
        "count": [len(table)],
    }
    quantiles = np.quantile(table, list(QUANTILES.values()), axis=0)
    return stats | {name: row.tolist() for name, row in zip(QUANTILES, quantiles, strict=True)}


def image_stats(histogram: NDArray[np.int64], frames: int) -> Stats:
    """Statistics of a (3, 256) histogram of pixel values, scaled to 0..1; each has shape (3, 1, 1)."""
    level = np.arange(256) / 255
    share = histogram / histogram.sum(1, keepdims=True)
    mean = share @ level
    seen = histogram > 0
    stats = {
        "min": level[seen.argmax(1)],
        "max": level[255 - seen[:, ::-1].argmax(1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ level**2 - mean**2, 0)),
    }
    below = share.cumsum(1)
    stats |= {name: level[(below < q - 1e-12).sum(1).clip(max=255)] for name, q in QUANTILES.items()}
    shaped: Stats = {name: value.reshape(3, 1, 1).tolist() for name, value in stats.items()}
    return shaped | {"count": [frames]}


def _histogram(image: bytes) -> NDArray[np.int64]:
    pixels = decode_image(image)[::PIXEL_STRIDE, ::PIXEL_STRIDE].reshape(-1, 3)
    return np.stack([np.bincount(pixels[:, channel], minlength=256) for channel in range(3)])
