"""The command that serves a pilot: serve."""

from __future__ import annotations

import sys
import threading
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes as Flat

from cognitivedrone.errors import import_extra
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.text.printable import wrapped

EXTRA = "serve"


def serve(plan: Annotated[Flat[ServePlan], tyro.conf.arg(name="")]) -> None:
    """Serve a policy, and maybe a reasoner in front of it, until ctrl-C.

    Clients are `--policy remote:ws://HOST:PORT` and `--reasoner remote:ws://HOST:PORT` in every command here, openpi's
    client, and OpenVLA's REST at /act. Only this machine can connect unless --host is given; read docs/own_policy.md
    before you do that. Needs the extra `serve`. Examples:

      cognitivedrone serve --policy small --reasoner small
      cognitivedrone serve --policy openvla:checkpoints/7b --host 0.0.0.0 --token-file token
      cognitivedrone bench --policy remote:ws://127.0.0.1:8000 --suite open-v1:smoke
    """
    for package in ("uvicorn", "starlette", "websockets", "msgpack"):
        import_extra(package, EXTRA)
    from cognitivedrone.apps.watchdog import end_lingering
    from cognitivedrone.serving.server import announced, logging_to_stderr
    from cognitivedrone.serving.server import serve as run

    threads = frozenset(threading.enumerate())
    try:
        with logging_to_stderr():
            run(plan, lambda address: print(wrapped(announced(plan, address), sys.stdout), flush=True))  # noqa: T201
    finally:
        end_lingering(threads, 1)  # a policy that hangs
