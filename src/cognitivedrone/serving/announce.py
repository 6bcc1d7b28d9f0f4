"""What the command `serve` prints: where the server is, and how to call it."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import ip_address

from cognitivedrone.remote.messages import TOKEN_VARIABLE
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.log_limit import LogLimit
from cognitivedrone.serving.server import Address

EVERY_ADDRESS = "ADDRESS-OF-THIS-MACHINE"


def announced(plan: ServePlan, address: Address) -> str:
    """Some lines for a person who wants to use the server."""
    shown = Address(EVERY_ADDRESS if _is_every(address.host) else address.host, address.port)
    reasoner = plan.pilot.shown.reasoner
    pilot = plan.pilot.shown.policy if reasoner == "none" else f"{plan.pilot.shown.policy} behind {reasoner}"
    policy = f"--policy remote:ws://{shown}"
    lines = [
        f"serving {pilot} at ws://{address} (ctrl-C stops)",
        f"  score it     cognitivedrone bench {policy}" + _reasoner(plan, shown),
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
    """Inside, the server's log goes to standard error, within the limit of `LogLimit`."""
    handler = logging.StreamHandler(sys.stderr)
    handler.addFilter(LogLimit())
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


def _reasoner(plan: ServePlan, shown: Address) -> str:
    return "" if plan.pilot.reasoner == "none" else f" --reasoner remote:ws://{shown}"
