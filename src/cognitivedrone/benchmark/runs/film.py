"""Films an episode of a recorded run: flies it again as it was flown, and writes `flight.mp4` and `flight.html`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import pilot_of, plan_of, resolve
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.errors import RunError
from cognitivedrone.files import check_no_link, writing
from cognitivedrone.film.frame import Film, scenes_of, verdict_of
from cognitivedrone.film.movie import write_flight
from cognitivedrone.tasks import SUITES

FILMS_FOLDER: Final = "films"
"""In the folder of a run, one folder for every filmed episode."""


@dataclass(frozen=True, slots=True)
class Filmed:
    """A film of an episode."""

    page: Path
    headline: str
    """The outcome, in words."""
    repeats: bool
    """Whether the filmed flight ended like the recorded one; a pilot that draws lots may not."""


def film_episode(
    run: Path,
    episode: int = 0,
    *,
    policy: str | None = None,
    reasoner: str | None = None,
    tasks: Path | None = None,
    labels: Path | None = None,
    out: Path | None = None,
) -> Filmed:
    """Fly an episode of the finished run in the folder `run` again, and film it, by default into a folder in it.

    `policy` and `reasoner` name a user's own code, `tasks` and `labels` the files that were flown: a run records only
    their hashes. Raises `RunError` if the episode is not in the run or cannot be flown as it was.
    """
    results = read_results(run)
    facts = results.run
    recorded = {each.episode: each for each in results.episodes}
    if episode not in recorded:
        raise RunError(f"{run} has no episode {episode}; it has {min(recorded)} to {max(recorded)}")
    if facts.option("link") != "sim":
        raise RunError(f"the run was flown with --link {facts.option('link')}, which does not fly twice the same")
    if facts.suite.name not in SUITES and tasks is None:
        raise RunError(f"the run flew the tasks {facts.suite.name!r}; give their file or folder with --tasks")
    if facts.option("labels") is not None and labels is None:
        raise RunError("the run showed pictures of its own; give their folder with --labels")
    folder = out or run / FILMS_FOLDER / f"{episode:04}"
    if out is None:
        with writing(folder, RunError, "give another folder with --out"):
            check_no_link(run, FILMS_FOLDER)
            check_no_link(run / FILMS_FOLDER, folder.name)
    given = {"tasks": tasks, "labels": labels, "shard": None}
    job = resolve(plan_of(facts, pilot_of(facts, policy, reasoner), **given))
    if job.suite.digest != facts.suite.digest:
        raise RunError(f"the tasks {facts.suite.name!r} are not those of the run; give the same ones with --tasks")
    runner = PilotRunner(job)
    try:
        flown = runner.fly(episode, film=True)
        scenes = scenes_of(runner.track_runner)
    finally:
        runner.close()
    ends, ended = ([stage.outcome for stage in each.stages] for each in (recorded[episode], flown.result))
    verdict = verdict_of(flown.result.stages)
    title = f"{facts.suite.name}, episode {episode}: {facts.policy} + {facts.reasoner}"
    film = Film(title, flown.film or (), scenes, verdict)
    page = write_flight(folder, film, job.request.airframe)
    return Filmed(page, verdict.headline, ends == ended)
