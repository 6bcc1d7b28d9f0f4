"""What the page does: flights one after the other, in the thread that calls `run`; the page's buttons start them."""

from __future__ import annotations

import io
import queue
import shlex
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import PIL.Image

from cognitivedrone.apps.config import AUTO, FlyPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.apps.log import verdict_of_flight
from cognitivedrone.apps.orders import Orders
from cognitivedrone.apps.understanding.scene import DEFAULT, DEFAULT_EPISODE, ChosenScene, named_scene
from cognitivedrone.apps.values import Summary
from cognitivedrone.envs.captions import readable
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import CognitiveDroneError, NotUnderstood, ServerError, TaskError
from cognitivedrone.film.frame import scenes_of
from cognitivedrone.labels import load_pack
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.plan import PilotSpec
from cognitivedrone.play.board import LiveBoard
from cognitivedrone.play.config import PlayPlan
from cognitivedrone.play.flight import FlightControls, command_line
from cognitivedrone.play.lesson import PANELS, Lesson, Picture, keep_picture, own_scene, renamed
from cognitivedrone.play.server import Channels
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import SUITES
from cognitivedrone.tasks.suites import suite_of
from cognitivedrone.terminal import console
from cognitivedrone.types import Task

_PICTURES: Final = "pictures"


class Studio(FlightControls):
    """The state behind the page. `run` flies; `do` and the others are called by the server's threads.

    Raises `TaskError` or `LabelError` if the plan names a suite, a task file or pictures that do not exist.
    """

    def __init__(self, plan: PlayPlan, channels: Channels) -> None:
        self.plan = plan
        self.out = plan.out or Path("flights") / datetime.now().strftime("%Y-%m-%d-%H%M%S")
        self._channels = channels
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._pilot: Pilot | None = None
        self._spec, self._opened = plan.pilot, ExitStack()
        self._phase, self._notice = "loading", ""
        self._outcome: dict[str, str] = {}
        named = plan.scenario.suite != AUTO or plan.scenario.tasks is not None
        self._mode = "suite" if named else "words"
        self._suite = plan.scenario.suite if named else DEFAULT
        self._tasks = plan.scenario.tasks
        self._episode, self._seed, self._flights = 0 if named else DEFAULT_EPISODE, plan.scenario.seed, 0
        self._pictures: tuple[Picture | None, ...] = (None,) * PANELS
        self._naming = threading.RLock()
        """Held while pictures change: uploads come from several threads, and no two may take one name."""
        self._task: Task | None = None
        self._labels: str | Path | None = plan.scenario.labels
        self._record, self._target_shown, self._command = False, False, ""
        self._last = ""
        """The sentence of the last flight."""
        self._film: Path | None = None
        self._lesson: Lesson | None = None
        self._scene()  # a wrong name is reported before a page opens
        load_pack(self._labels)
        super().__init__(LiveBoard(channels, find_airframe(plan.scenario.airframe)))

    # Of the server's threads.

    def begin(self, text: str) -> None:
        """As `FlightControls`: it flies when the pilot is there, and the sentence typed before is flown."""
        self._jobs.put(lambda: self._fly(text))
        if self._phase == "loading":
            self._notice = "the pilot is still being loaded; it flies then"

    def _do_record(self, values: dict[str, Any]) -> None:
        self._record = bool(values.get("on"))

    def _do_reveal(self, _: dict[str, Any]) -> None:
        self._target_shown = not self._target_shown

    def _do_repeat(self, _: dict[str, Any]) -> None:
        if self.orders is None and self._last:
            self._jobs.put(lambda: self._fly(self._last))

    def _do_scene(self, values: dict[str, Any]) -> None:
        """Another scene: by mode, suite and episode, or the next one."""
        if self.orders is not None:
            raise ServerError("it is flying; land first")
        self._jobs.put(lambda: self._change(values))

    def _change(self, values: dict[str, Any]) -> None:
        mode = values.get("mode", self._mode)
        if mode not in ("words", "suite", "mine"):
            raise ServerError(f"there is no kind of scene {str(mode)[:40]!r}")
        suite, episode = values.get("suite", self._suite), values.get("episode", self._episode)
        if not isinstance(suite, str) or not isinstance(episode, int) or episode < 0:
            raise ServerError("a scene is named by a suite and the number of a task, from 0")
        before = self._mode, self._suite, self._episode, self._seed
        self._mode, self._suite, self._episode = mode, suite, episode
        if values.get("next"):
            self._seed += 1
            self._episode += mode == "suite" and "episode" not in values
        try:
            self._preview()
        except CognitiveDroneError:
            self._mode, self._suite, self._episode, self._seed = before
            raise

    def _do_clear(self, values: dict[str, Any]) -> None:
        slot = int(values["slot"]) % PANELS
        with self._naming:
            self._pictures = tuple(None if i == slot else each for i, each in enumerate(self._pictures))
        self._do_scene({"mode": "mine"})

    def _do_rename(self, values: dict[str, Any]) -> None:
        slot = int(values["slot"]) % PANELS
        with self._naming:
            before = self._pictures[slot]
            if before is None:
                return
            taken = [each.name for i, each in enumerate(self._pictures) if each is not None and i != slot]
            after = renamed(self.out / _PICTURES, before, str(values.get("name", "")), taken)
            self._pictures = tuple(after if i == slot else each for i, each in enumerate(self._pictures))
        self._do_scene({"mode": "mine"})

    def _do_teach(self, _: dict[str, Any]) -> None:
        if self._lesson is not None and not self._lesson.done:
            raise ServerError("a lesson is running; wait for its end")
        if sum(each is not None for each in self._pictures) < 2:
            raise ServerError(
                "a lesson needs pictures of at least two things, so that there is something to tell apart"
            )
        number = 1
        while (self.out / f"lesson-{number}").exists():
            number += 1
        self._lesson = Lesson(self.out / _PICTURES, self.out / f"lesson-{number}", self._taught)
        self._command = shlex.join(["cognitivedrone", *self._lesson.words])

    def _taught(self) -> None:
        """Called as a lesson goes on."""
        if self._lesson is not None and self._lesson.done and not self._lesson.failed:
            self._jobs.put(self._take_lesson)
        self.publish()

    def take_picture(self, slot: int, name: str, content: bytes) -> None:
        """As `Controls`."""
        if slot not in range(PANELS):
            raise ServerError(f"there are {PANELS} panels")
        with self._naming:
            taken = [each.name for i, each in enumerate(self._pictures) if each is not None and i != slot]
            kept = keep_picture(self.out / _PICTURES, name, content, slot, taken)
            self._pictures = tuple(kept if i == slot else each for i, each in enumerate(self._pictures))
        if self.orders is None:
            self._jobs.put(lambda: self._change({"mode": "mine"}))
        else:
            self._notice = f"{kept.name!r} stands there in the next flight"
        self.publish()

    def picture(self, slot: int) -> bytes:
        """As `Controls`."""
        task = self._task
        if task is None or slot not in range(PANELS):
            raise TaskError("there is no such panel")
        buffer = io.BytesIO()
        PIL.Image.fromarray(load_pack(self._pack()).image(task.labels[slot])).save(buffer, "PNG")
        return buffer.getvalue()

    def film(self, run: int, episode: int) -> Path:  # noqa: ARG002
        """As `Controls`: of the last flight."""
        if self._film is None:
            raise TaskError("there is no film; switch recording on, and fly")
        return self._film

    def stop(self) -> None:
        """End the flight, and `run`."""
        self._stopping.set()

    # Of the thread that flies.

    def run(self) -> None:
        """Show the first scene, load the pilot, and fly what is asked for, until `stop` or ctrl-C."""
        try:
            self._attempt(self._preview)
            self._load(self._spec)
            self._phase = "ready"
            self._attempt(self._preview)
            while not self._stopping.is_set():
                with suppress(queue.Empty):
                    self._attempt(self._jobs.get(timeout=0.2))
        finally:
            if self._lesson is not None:
                self._lesson.stop()
            self._opened.close()
            self.board.close()

    def _load(self, spec: PilotSpec) -> None:
        """Open a pilot; the one of before is closed."""
        with ExitStack() as stack:
            self._pilot = stack.enter_context(open_pilot(spec))
            opened, self._opened = self._opened, stack.pop_all()
        self._spec = spec
        opened.close()

    def _take_lesson(self) -> None:
        assert self._lesson is not None  # noqa: S101  (`_taught` was called for it)
        self._load(self._lesson.pilot)
        self._mode = "mine"
        self._preview()

    def _attempt(self, job: Callable[[], None]) -> None:
        """A job of the page; what is wrong is shown there."""
        self._notice = ""
        try:
            job()
        except CognitiveDroneError as error:
            self._notice = str(error)
        self.publish()

    def _pack(self) -> str | Path | None:
        return self.out / _PICTURES if self._mode == "mine" and any(self._pictures) else self._labels

    def _scene(self, instruction: str = "") -> tuple[ChosenScene | None, int | None]:
        """The scene of now, and which gate is known to be right; none where the words choose it."""
        if self._mode == "mine":
            return own_scene(self._pictures, instruction, self._seed)
        if self._mode == "words" and instruction:
            return None, None
        scenario = self.plan.scenario.changed(suite=self._suite, tasks=self._tasks)
        scene = named_scene(suite_of(scenario, self._episode + 1), self._episode)
        return scene, scene.track[0].target

    def _preview(self) -> None:
        """Show the drone at the start of the scene."""
        scene, _ = self._scene()
        assert scene is not None  # noqa: S101  (without words there is one)
        self._task, self._outcome, self._target_shown = scene.track[0], {}, False
        conditions = TrackConfig.of(self.plan.scenario, time_limit_s=float("inf"))
        simulator = Simulator(1, airframe=find_airframe(self.plan.scenario.airframe))
        try:
            runner = TrackRunner(simulator.world(0), load_pack(self._pack()), conditions)
            runner.begin(scene.track, episode_rng(scene.suite.digest, scene.episode, self._seed))
            image, state = runner.world.frame().copy(), runner.world.state()
            pilot = self._pilot
            if pilot is not None and pilot.reasoner is not None:
                looking = pilot.reasoner.fork()
                if looking is not None:
                    with suppress(CognitiveDroneError):
                        looking.refine(image, scene.track[0].instruction)
                    pilot = Pilot(pilot.policy, looking)
            position, quaternion = state.position.copy(), state.quaternion.copy()
            self.board.wait_at(scenes_of(runner)[0], image, position, quaternion, pilot)
        finally:
            simulator.close()

    def _fly(self, instruction: str) -> None:
        """One flight."""
        assert self._pilot is not None  # noqa: S101  (`run` opened it)
        scene, target = self._scene(instruction)
        if scene is not None:
            self._task = scene.track[0]
        self._flights += 1
        while (folder := self.out / f"{self._flights:03}").exists():  # of another time with the same --out
            self._flights += 1
        scenario = self.plan.scenario.changed(seed=self._seed, labels=self._pack())
        plan = FlyPlan(
            instruction, scenario, self._spec, time_limit=self.plan.time_limit, out=folder, film=self._record,
            view=False,
        )  # fmt: skip
        shown = plan if self._mode != "suite" else plan.changed(suite=self._suite, episode=self._episode)
        self._command = command_line(shown)
        orders = self.orders = Orders()
        self._phase, self._outcome, self._film = "flying", {}, None
        self.publish()
        try:
            summary = fly_mission(
                plan, console=console(file=io.StringIO()), keyboard=io.StringIO(), orders=orders, page=self.board,
                pilot=self._pilot, scene=scene,
            )  # fmt: skip
        except NotUnderstood as error:
            self._outcome = {"kind": "open", "headline": "Not understood", "text": str(error)}
            return
        finally:
            self.orders, self._phase = None, "ready"
            self.board.sticks.taken = False
        self._last = instruction
        judged = self._mode != "mine" or target is not None
        self._outcome = outcome_table(summary, judged=judged)
        if summary.track:
            self._task = summary.track[0]
        if self._record and (folder / "flight.mp4").is_file():
            self._film = folder / "flight.mp4"
        if summary.ending.kind == "interrupted":
            self._stopping.set()

    def publish(self) -> None:
        """As `FlightControls`."""
        task, lesson = self._task, self._lesson
        self._channels.publish(
            "session",
            {
                "phase": self._phase,
                "notice": self._notice,
                "outcome": self._outcome,
                "mode": self._mode,
                "suite": self._suite,
                "suites": sorted(SUITES),
                "episode": self._episode,
                "seed": self._seed,
                "instruction": "" if task is None else task.mission or task.instruction,
                "options": [] if task is None else [readable(option) for option in task.options],
                "target": task.target if task is not None and self._target_shown else None,
                "revealed": self._target_shown,
                "pictures": [None if each is None else each.name for each in self._pictures],
                "sentences": list(self.sentences),
                "record": self._record,
                "film": None if self._film is None else self._flights,
                "command": self._command,
                "folder": str(self.out),
                "pilot": f"{self._spec.shown.policy} + {self._spec.shown.reasoner}",
                "steered": True,
                "lesson": None if lesson is None else {"text": lesson.text, "share": lesson.share, "done": lesson.done},
            },
        )


def outcome_table(summary: Summary, *, judged: bool = True) -> dict[str, str]:
    """How a flight ended, for the page; where nobody but the user can judge it, only what it did."""
    chosen = summary.results[-1].chosen if summary.results else None
    if not judged and chosen is not None:
        return {"kind": "open", "headline": f"Through gate {chosen + 1}", "text": f"{summary.seconds:.1f} s; you judge"}
    verdict = verdict_of_flight(summary)
    return {"kind": verdict.kind, "headline": verdict.headline, "text": "; ".join(verdict.lines)}
