"""Video clips for the report: selection of episodes, and their frames as small MP4 files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cognitivedrone.benchmark.scores.run_types import Rollout, Trace
from cognitivedrone.data.episode import encode_image
from cognitivedrone.film.movie import encode_mp4
from cognitivedrone.film.overlays import compose
from cognitivedrone.types import EpisodeResult, Outcome, Track

FAILURES: Final = 6
"""Maximum number of clips of failures, if there are passes to show."""
POSTER_STEP: Final = 5
"""Step of the poster image: half a second into the flight, when the reasoner has answered."""
POSTER_QUALITY: Final = 60
"""JPEG quality of the poster."""


@dataclass(frozen=True, slots=True)
class Clip:
    """The film of one episode."""

    result: EpisodeResult
    """Result of the filmed flight."""
    track: Track
    trace: Trace
    video: bytes
    """MP4; empty if there was no frame."""
    poster: bytes
    """JPEG of an early frame; empty if there was none."""
    repeats: bool
    """Whether the filmed flight ended like the scored one; a non-deterministic policy may fly differently."""


def choose_clips(results: Sequence[EpisodeResult], limit: int) -> list[int]:
    """Episodes to film, in order: failures of every kind first, then a pass of every family, up to `limit`.

    Depends only on the results.
    """
    results = sorted(results, key=lambda result: result.episode)
    failures = [result for result in results if _failure(result) is not None]
    passes = [result for result in results if _failure(result) is None]
    first_of_family: dict[str, int] = {}
    for result in passes:
        first_of_family.setdefault(result.stages[0].family, result.episode)
    shown_passes = list(first_of_family.values())
    room = max(min(FAILURES, limit), limit - len(shown_passes))
    chosen = _varied(failures, room)
    return chosen + shown_passes[: limit - len(chosen)]


def make_clip(flown: Rollout, track: Track, scored: EpisodeResult) -> Clip:
    """A clip of a filmed flight; `scored` is the scored result of the same episode."""
    same = [stage.outcome for stage in flown.result.stages] == [stage.outcome for stage in scored.stages]
    film = [compose(frame, len(track)) for frame in flown.film or []]
    poster = encode_image(film[min(POSTER_STEP, len(film) - 1)], "jpeg", POSTER_QUALITY) if film else b""
    return Clip(flown.result, track, flown.trace, encode_mp4(film), poster, same)


def _failure(result: EpisodeResult) -> tuple[Outcome, str] | None:
    """Outcome and family of the first stage that was not passed."""
    return next(((stage.outcome, stage.family) for stage in result.stages if stage.outcome != "passed"), None)


def _varied(failures: Sequence[EpisodeResult], room: int) -> list[int]:
    """Up to `room` episodes; each has the outcome, then the family, shown least so far."""
    left = {result.episode: _failure(result) for result in failures}
    outcomes: Counter[str] = Counter()
    families: Counter[str] = Counter()
    chosen: list[int] = []
    while left and len(chosen) < room:

        def shown(episode: int) -> tuple[int, int, int]:
            outcome, family = left[episode] or ("", "")
            return outcomes[outcome], families[family], episode

        episode = min(left, key=shown)
        outcome, family = left.pop(episode) or ("", "")
        outcomes[outcome] += 1
        families[family] += 1
        chosen.append(episode)
    return chosen
