"""The page's buttons during a flight: speak, land, take over. `FlightPage` is the page of one flight of `fly`."""

from __future__ import annotations

import shlex
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Any, Final

import numpy as np

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.orders import LONGEST, Orders
from cognitivedrone.apps.values import Ending
from cognitivedrone.errors import ServerError
from cognitivedrone.play.board import LiveBoard
from cognitivedrone.play.config import PageSpec
from cognitivedrone.play.server import Channels, Controls, serving_page
from cognitivedrone.serving.access import token_of
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.text.printable import shown_address
from cognitivedrone.types import ACTION_LIMITS, Action

SENTENCES_KEPT: Final = 40
"""Sentences of the history."""


class FlightControls(Controls):
    """What every page of a flight can do; subclasses add `_do_NAME` for their own buttons, and say what is shown."""

    steered = True
    """Whether a person may take over from the page: only in simulation."""

    def __init__(self, board: LiveBoard) -> None:
        self.board = board
        self.sentences: deque[dict[str, str]] = deque(maxlen=SENTENCES_KEPT)
        self.orders: Orders | None = None
        """Of the flight, while there is one."""

    def do(self, command: str, values: dict[str, Any]) -> None:
        """As `Controls`."""
        handler: Callable[[dict[str, Any]], None] | None = getattr(self, f"_do_{command}", None)
        if handler is None:
            raise ServerError(f"this page cannot {command[:40]!r}; reload it")
        handler(values)
        self.publish()

    def publish(self) -> None:
        """Show the state on the page."""
        raise NotImplementedError

    def begin(self, text: str) -> None:
        """Begin a flight for a sentence that was typed while there is none."""
        raise ServerError(f"the flight is over; {text[:60]!r} came too late")

    def _do_say(self, values: dict[str, Any]) -> None:
        text = " ".join(str(values.get("text", "")).split())[:LONGEST]
        if not text or not text.isprintable():
            raise ServerError("say what to fly to, such as 'fly to the dog'")
        self.sentences.append({"text": text, "at": datetime.now().strftime("%H:%M:%S")})
        if (orders := self.orders) is not None:
            self.board.sticks.taken = False
            orders.say(text)
        else:
            self.begin(text)

    def _do_land(self, _: dict[str, Any]) -> None:
        if (orders := self.orders) is not None:
            orders.land(Ending("ordered", "landed from the page"))

    def _do_hold(self, _: dict[str, Any]) -> None:
        self._move(np.zeros(4, np.float32))

    def _do_stick(self, values: dict[str, Any]) -> None:
        sent = np.asarray(values["action"], np.float32)
        if sent.shape != (4,) or not np.isfinite(sent).all():
            raise ServerError("a stick's command is four numbers")
        self._move((np.clip(sent, -1, 1) * ACTION_LIMITS).astype(np.float32))

    def _move(self, command: Action) -> None:
        if not self.steered:
            raise ServerError("a page cannot steer a vehicle: take over with its remote control, or press land")
        if self.orders is not None:
            self.board.sticks.move(command)

    def _do_release(self, _: dict[str, Any]) -> None:
        self.board.sticks.taken = False


def command_line(plan: FlyPlan) -> str:
    """The command that flies a plan without the page."""
    changes = plan.changed(out=None, view=True, film=True, page=False, page_port=0).changes()
    for name in ("page_port", "instruction"):  # the latter has no flag
        changes.pop(name, None)
    flags = {f"--{name.replace('_', '-')}": shown_address(str(value)) for name, value in changes.items()}
    words = [word for pair in flags.items() for word in pair]
    return shlex.join(["cognitivedrone", "fly", *([plan.instruction] if plan.instruction else []), *words])


class FlightPage(FlightControls):
    """The page of one flight of the command `fly`."""

    def __init__(self, plan: FlyPlan, board: LiveBoard, channels: Channels) -> None:
        super().__init__(board)
        self.steered = plan.vehicle.kind == "sim"
        self.orders = Orders()
        self._channels = channels
        self._plan = plan
        self.publish()

    def publish(self) -> None:
        """As `FlightControls`."""
        plan = self._plan
        self._channels.publish(
            "session",
            {
                "phase": "flying",
                "mode": "flight",
                "sentences": list(self.sentences),
                "instruction": plan.instruction,
                "command": command_line(plan),
                "pilot": f"{plan.pilot.shown.policy} + {plan.pilot.shown.reasoner} on {plan.vehicle.link}",
                "steered": self.steered,
            },
        )


@contextmanager
def page_of_flight(plan: FlyPlan, ready: Callable[[str], None]) -> Iterator[FlightPage]:
    """The page of a flight, for the time of the block; `ready` gets its address."""
    spec = PageSpec(port=plan.page_port)
    channels = Channels()
    board = LiveBoard(channels, find_airframe(plan.scenario.airframe))
    try:
        page = FlightPage(plan, board, channels)
        with serving_page(spec, channels, page, token_of(spec.host, None)) as address:
            ready(address)
            yield page
    finally:
        board.close()
