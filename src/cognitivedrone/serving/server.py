"""Runs the web application: opens the port, says where it is, serves until stopped."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from ipaddress import ip_address

import uvicorn

from cognitivedrone.errors import ServerError
from cognitivedrone.files import reason_of
from cognitivedrone.pilot import open_pilot
from cognitivedrone.remote.connection import keep_alive
from cognitivedrone.remote.messages import TOKEN_VARIABLE
from cognitivedrone.serving.access import token_of
from cognitivedrone.serving.app import PolicyServer
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.sessions import ServedPilot
from cognitivedrone.system.interrupts import until_asked

STOP_S = 2
"""Time that clients have to leave when the server stops, s."""
MOST_WAITING = 192
"""Maximum number of connections beyond those of websocket clients: of REST, and those that have asked nothing yet."""
KEEP_ALIVE_S = 10
"""Time for which a connection of REST is kept without a request, s."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where a server listens."""

    host: str
    port: int
    needs_token: bool = False

    @property
    def uri_host(self) -> str:
        """The host as an address of the web has it: one of IPv6 in brackets."""
        return f"[{self.host}]" if ":" in self.host else self.host

    def __str__(self) -> str:
        return f"{self.uri_host}:{self.port}"


def serve(plan: ServePlan, ready: Callable[[Address], None], stop: threading.Event | None = None) -> None:
    """Serve until interrupted, or until `stop` is set; `ready` is called once clients can connect.

    Raises `ServerError` if the port cannot be opened or a token is missing, `PolicyError` for the pilot.
    """
    token = token_of(plan.bare_host, plan.token_file)
    with contextlib.ExitStack() as stack:
        listening = stack.enter_context(contextlib.closing(_listen(plan)))
        served = ServedPilot(plan.pilot, stack.enter_context(open_pilot(plan.pilot)))
        address = Address(plan.bare_host, listening.getsockname()[1], token is not None)
        with until_asked() as asked:

            def stopped() -> bool:
                return asked() or (stop is not None and stop.is_set())

            asyncio.run(_run(plan, served, token, listening, lambda: ready(address), stopped))
        if asked():
            raise KeyboardInterrupt


class _Server(uvicorn.Server):
    """Leaves the signals to us: uvicorn would raise those that it has handled once more at its end."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Do nothing."""
        yield


@contextlib.contextmanager
def serving(plan: ServePlan) -> Iterator[Address]:
    """A server in a thread of this process, for tests and examples."""
    stop, ready = threading.Event(), threading.Event()
    found: list[Address] = []
    errors: list[BaseException] = []

    def listening(address: Address) -> None:
        found.append(address)
        ready.set()

    def run() -> None:
        try:
            serve(plan, listening, stop)
        except BaseException as error:
            errors.append(error)
        finally:
            ready.set()

    thread = threading.Thread(target=run, name="serve")
    thread.start()
    ready.wait()
    try:
        if errors:
            raise errors[0]
        yield found[0]
    finally:
        stop.set()
        thread.join()
    if errors:
        raise errors[0]


def _listen(plan: ServePlan) -> socket.socket:
    family = socket.AF_INET6 if ":" in plan.host else socket.AF_INET
    try:
        listening = socket.create_server((plan.bare_host, plan.port), family=family, backlog=128)
        keep_alive(listening)  # connections inherit these
        return listening
    except OSError as error:
        raise ServerError(
            f"cannot listen at {plan.host}, port {plan.port}: {reason_of(error)}; give another --host or --port"
        ) from None


async def _run(
    plan: ServePlan,
    served: ServedPilot,
    token: str | None,
    listening: socket.socket,
    ready: Callable[[], None],
    stop: Callable[[], bool],
) -> None:
    application = PolicyServer(served, plan.limits, token)
    server = _Server(
        uvicorn.Config(
            application.app,
            http="h11",
            ws="websockets-sansio",
            limit_concurrency=plan.limits.clients + MOST_WAITING,
            timeout_keep_alive=KEEP_ALIVE_S,
            # A client that computes does not answer pings either; `_listen` asks its operating system.
            ws_ping_interval=None,
            ws_max_size=1000 * plan.limits.message_kb,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=STOP_S,
        )
    )
    running = asyncio.create_task(server.serve(sockets=[listening]))
    try:
        while not server.started and not running.done():
            await asyncio.sleep(0.01)
        if not running.done():
            ready()
        while not running.done():
            server.should_exit = server.should_exit or stop()
            await asyncio.wait([running], timeout=0.1)
        await running
    finally:
        await application.close()


EVERY_ADDRESS = "ADDRESS-OF-THIS-MACHINE"


def announced(plan: ServePlan, address: Address) -> str:
    """Some lines for a person who wants to use the server."""
    shown = Address(EVERY_ADDRESS if _is_every(address.host) else address.host, address.port)
    reasoner = plan.pilot.shown.reasoner
    pilot = plan.pilot.shown.policy if reasoner == "none" else f"{plan.pilot.shown.policy} behind {reasoner}"
    policy = f"--policy remote:ws://{shown}"
    lines = [
        f"serving {pilot} at ws://{address} (ctrl-C stops)",
        f"  score it     cognitivedrone bench {policy}"
        + ("" if plan.pilot.reasoner == "none" else f" --reasoner remote:ws://{shown}"),
        f'  openpi       WebsocketClientPolicy("{shown.uri_host}", {shown.port})',
        f"  OpenVLA      POST http://{shown}/act",
        f"  health       http://{shown}/healthz",
    ]
    if address.needs_token:
        lines.append(f"  clients need the token, ours in the environment variable {TOKEN_VARIABLE}")
    return "\n".join(lines)


def _is_every(host: str) -> bool:
    """Whether a server at this host listens on every address of its machine, in any spelling."""
    try:
        return not host or ip_address(host).is_unspecified
    except ValueError:  # a name
        return False


@contextmanager
def logging_to_stderr() -> Iterator[None]:
    """Inside, the server's log goes to standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s", datefmt="%H:%M:%S"))
    loggers = [logging.getLogger(name) for name in ("cognitivedrone.serving", "uvicorn.error")]
    before = [(logger.level, logger.propagate) for logger in loggers]
    for logger, level in zip(loggers, (logging.INFO, logging.WARNING), strict=True):
        logger.addHandler(handler)
        logger.setLevel(level)
        logger.propagate = False
    try:
        yield
    finally:
        for logger, (level, propagate) in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)
            logger.propagate = propagate
