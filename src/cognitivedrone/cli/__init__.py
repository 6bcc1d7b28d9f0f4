"""The `cognitivedrone` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import tyro

from cognitivedrone.cli import data, flying, scoring, training
from cognitivedrone.errors import CognitiveDroneError, warn_plainly

app = tyro.extras.SubcommandApp()
app.command(scoring.bench)
app.command(scoring.reason)
app.command(scoring.sweep)
app.command(scoring.compare)
app.command(scoring.view)
app.command(data.collect)
app.command(training.train)
app.command(training.train_openvla)
app.command(data.data, name="data", help="Look at, check, convert and replay data sets.")
app.command(flying.fly)
app.command(flying.sim)
app.command(flying.gazebo, name="gazebo", help="Worlds for Gazebo: the same tasks, flown by ArduPilot.")
app.command(name="list")(scoring.list_names)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; a mistake of the user's ends in one sentence and exit code 2."""
    warn_plainly()
    try:
        app.cli(prog="cognitivedrone", description=__doc__, args=arguments)
    except CognitiveDroneError as error:
        print(f"cognitivedrone: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(2)
    except KeyboardInterrupt as stop:
        print(f"cognitivedrone: {stop or 'stopped'}", file=sys.stderr)  # noqa: T201
        sys.exit(130)
