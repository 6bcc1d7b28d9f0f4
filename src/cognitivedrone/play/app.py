"""The command `play`: opens the page, and flies what is typed or spoken there."""

from __future__ import annotations

import shutil
import threading
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack

from cognitivedrone.play.channels import Channels
from cognitivedrone.play.config import PlayPlan
from cognitivedrone.play.replay import Replay
from cognitivedrone.play.server import serving_page
from cognitivedrone.play.studio import Studio
from cognitivedrone.serving.access import token_of
from cognitivedrone.system import has_screen

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
