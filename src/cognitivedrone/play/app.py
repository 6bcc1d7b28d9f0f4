"""The command `play`: opens the page, and flies what is typed or spoken there.

Recorded runs on the page: episodes side by side as films, which are made when they are asked for.
"""

from __future__ import annotations

import shutil
import threading
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from cognitivedrone.benchmark.runs.film import FILMS_FOLDER, film_episode
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.errors import ServerError, TaskError
from cognitivedrone.files import check_no_link, reason_of
from cognitivedrone.film.frame import OUTCOME_TEXTS
from cognitivedrone.film.movie import FILM_FILE
from cognitivedrone.play.config import PlayPlan
from cognitivedrone.play.server import Channels, Controls, serving_page
from cognitivedrone.play.studio import Studio
from cognitivedrone.serving.access import token_of
from cognitivedrone.system import has_screen

RUNS: Final = 4
"""Maximum number side by side."""


class Replay(Controls):
    """The state behind the page of recorded runs. Raises `RunError` if a folder is none of a finished run."""

    def __init__(self, folders: Sequence[Path], channels: Channels) -> None:
        if len(folders) > RUNS:
            raise ServerError(f"{len(folders)} runs are too many to look at side by side; give at most {RUNS}")
        self._folders, self._channels = tuple(folders), channels
        self._results = [read_results(folder) for folder in folders]
        self._making = threading.Lock()
        common = set.intersection(*({each.episode for each in found.episodes} for found in self._results))
        if not common:
            raise ServerError("these runs have no episode in common")
        self._episodes = sorted(common)
        self._chosen = self._episodes[0]
        self._publish()

    def do(self, command: str, values: dict[str, Any]) -> None:
        """As `Controls`: only another episode can be chosen."""
        if command != "scene":
            raise ServerError("these are recorded flights; `cognitivedrone play` without a run flies")
        episode = values.get("episode")
        if episode not in self._episodes:
            raise ServerError(f"these runs share no episode {str(episode)[:20]}")
        self._chosen = episode
        self._publish()

    def film(self, run: int, episode: int) -> Path:
        """As `Controls`."""
        if run not in range(len(self._folders)) or episode not in self._episodes:
            raise TaskError("there is no such film")
        name = f"{FILMS_FOLDER}/{episode:04}/{FILM_FILE}"
        made = self._folders[run] / name
        try:
            for parent in (FILMS_FOLDER, f"{FILMS_FOLDER}/{episode:04}", name):
                check_no_link(self._folders[run], parent)
        except OSError as error:
            raise TaskError(f"the film is not shown: {reason_of(error)}") from None
        with self._making:  # one at a time: two would be no faster
            if not made.is_file():
                film_episode(self._folders[run], episode)
        return made

    def _publish(self) -> None:
        runs = []
        for folder, results in zip(self._folders, self._results, strict=True):
            ended = next(each for each in results.episodes if each.episode == self._chosen)
            task = ended.stages[0]
            runs.append(
                {
                    "name": str(folder),
                    "pilot": f"{results.run.policy} + {results.run.reasoner}",
                    "suite": results.run.suite.name,
                    "task": f"{task.task_id}, {task.family}",
                    "outcome": ", ".join(OUTCOME_TEXTS[stage.outcome] for stage in ended.stages),
                }
            )
        self._channels.publish("replay", {"runs": runs, "episode": self._chosen, "episodes": self._episodes})


BROWSERS = ("xdg-open", "x-www-browser", "www-browser", "open", "wslview", "chromium", "firefox", "google-chrome")


def play(plan: PlayPlan, ready: Callable[[str], None], stop: threading.Event | None = None) -> None:
    """Serve the page and fly, until ctrl-C or `stop`; `ready` gets the page's address.

    Raises `ServerError` if the port is taken or a token is missing, `PolicyError` for the pilot.
    """
    token = token_of(plan.page.host, plan.page.token_file)
    channels = Channels()
    with ExitStack() as stack:
        if plan.runs:
            replay = Replay(plan.runs, channels)
            _announce(plan, stack.enter_context(serving_page(plan.page, channels, replay, token)), ready)
            (stop or threading.Event()).wait()
            return
        studio = Studio(plan, channels)
        if stop is not None:
            threading.Thread(target=_stop_with, args=(stop, studio), daemon=True).start()
        _announce(plan, stack.enter_context(serving_page(plan.page, channels, studio, token)), ready)
        studio.run()


def _announce(plan: PlayPlan, address: str, ready: Callable[[str], None]) -> None:
    """Tell the address, and open it in this machine's browser, if it has one."""
    ready(address)
    if plan.page.browser and has_screen() and any(map(shutil.which, BROWSERS)):
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()


def _stop_with(stop: threading.Event, studio: Studio) -> None:
    stop.wait()
    studio.stop()
