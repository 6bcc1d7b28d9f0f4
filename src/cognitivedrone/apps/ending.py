"""Determines why a flight ended, from vehicle and scene."""

from __future__ import annotations

from cognitivedrone.apps.values import Ending
from cognitivedrone.envs.captions import readable
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.tasks.matching import asks_the_same
from cognitivedrone.types import StageResult, Task
from cognitivedrone.vehicles.contract import Vehicle

_DECLINED = "declined: no gate matches the instruction"
_UNJUDGED = ("wrong_gate", "false_alarm")
"""Outcomes that may be right where the user asks for something else than the scene."""


def ending_of(vehicle: Vehicle, instruction: str) -> Ending | None:
    """How the flight ended, or none while it continues: by the vehicle, or with the last stage of its track.

    `instruction` is the user's own, "" for the scene's. If it asks for something else than the scene's instruction,
    only the user knows which gate is right.
    """
    track = vehicle.track_runner
    if track is not None and track.finished:
        return _judged(track, instruction)
    return None if vehicle.over is None else Ending("vehicle", vehicle.over)


def flown_by_estimate(gates: int, *, done: bool) -> Ending | None:
    """How the flight of a vehicle without ground truth ended, once it has flown through all gates that were asked.

    `gates` is the pilot's own estimate; nobody but the user knows whether they were the right ones.
    """
    if not (done and gates):
        return None
    what = "a gate" if gates == 1 else f"{gates} gates"
    return Ending("flown", f"flew through {what} by its own estimate (not judged)")


def out_of_time(vehicle: Vehicle, seconds: float) -> Ending:
    """The ending at the time limit: a miss in a scene; a real flight is not judged."""
    return Ending("time" if vehicle.track_runner is None else "missed", f"the time limit of {seconds:g} s is over")


def _judged(track: TrackRunner, instruction: str) -> Ending:
    flown = [
        (result, task, instruction in ("", task.mission) or asks_the_same(instruction, task))
        for result, task in zip(track.results, track.track, strict=True)
        if result.outcome != "not_reached"
    ]
    text = "; ".join(_in_words(result, task, judged=judged) for result, task, judged in flown)
    if any(result.outcome != "passed" and (judged or result.outcome not in _UNJUDGED) for result, _, judged in flown):
        return Ending("missed", text)
    return Ending("passed" if all(judged for *_, judged in flown) else "flown", text)


def _pad(task: Task, index: int) -> str:
    return f"{task.gates[index].color} pad"


def _in_words(result: StageResult, task: Task, *, judged: bool) -> str:
    """How a stage ended, in words."""
    if not judged and result.chosen is not None and result.outcome in ("passed", "wrong_gate"):
        shown = "" if task.only is not None else f"{readable(task.options[result.chosen].removesuffix('.dae'))}; "
        return f"flew through gate {result.chosen + 1} ({shown}you judge), after {result.time_s:.1f} s"
    if not judged and result.outcome == "false_alarm":
        return f"{_DECLINED} (you judge), after {result.time_s:.1f} s"
    gate = "no gate" if result.chosen is None else f"gate {result.chosen + 1}"
    if task.landing and result.chosen is not None and result.outcome in ("passed", "wrong_gate"):
        wanted = (
            "" if result.outcome == "passed" or result.target is None else f", {_pad(task, result.target)} was right"
        )
        return f"landed on the {_pad(task, result.chosen)}{wanted}, after {result.time_s:.1f} s"
    right = "none was right" if result.target is None else f"the right one was {result.target + 1}"
    how = {
        "passed": f"through {gate}" if result.target is not None else _DECLINED if task.mission is None else "looked",
        "wrong_gate": f"through {gate}, {right}",
        "hesitated": "hovered, but did not report that no gate matches the instruction",
        "false_alarm": f"declined, but gate {result.target + 1} is right" if result.target is not None else "",
        "collision": f"collided, flying at {gate}",
        "missed": f"flew past the gates, at {gate}",
        "out_of_bounds": f"left the stage, flying at {gate}",
        "invalid": "the physics diverged",
    }.get(result.outcome, result.outcome)
    return f"{how}, after {result.time_s:.1f} s"
