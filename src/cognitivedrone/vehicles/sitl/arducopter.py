"""An ArduCopter process on our physics: found, started in a folder of its own, connected to, and ended.

The binary is built for SITL from ArduPilot's tree (docs/vehicles.md). It asks `SitlServer`, of `json_interface.py`, for
every step of physics, and listens for MAVLink on TCP. Options of its command line:
https://ardupilot.org/dev/docs/sitl-simulator-software-in-the-loop.html.
"""

from __future__ import annotations

import math
import os
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from cognitivedrone import system
from cognitivedrone.errors import LinkError
from cognitivedrone.files import create, open_regular, replace_file
from cognitivedrone.sim.airframe import IRIS, Airframe
from cognitivedrone.vehicles.mavlink.autopilot import with_both_names
from cognitivedrone.vehicles.sitl.json_interface import LINEAR_THRUST

T = TypeVar("T")

BINARY_VARIABLE = "ARDUCOPTER"
PARAMETERS = """\
FRAME_CLASS 1
FRAME_TYPE 1
MOT_BAT_VOLT_MIN 9.6
MOT_BAT_VOLT_MAX 12.8
BATT_MONITOR 4
ATC_RAT_YAW_FLTE 10
COMPASS_OFS_X 5
COMPASS_OFS_Y 13
COMPASS_OFS_Z -18
COMPASS_OFS2_X 5
COMPASS_OFS2_Y 13
COMPASS_OFS2_Z -18
COMPASS_OFS3_X 5
COMPASS_OFS3_Y 13
COMPASS_OFS3_Z -18
AHRS_EKF_TYPE 3
"""
"""What any of our airframes needs: how it is built, the offsets of the compasses that ArduCopter itself simulates, and
that its estimator is the real one (docs/vehicles.md)."""
SPIN_MIN, SPIN_MAX = 0.15, 0.95
"""Motor commands that ArduCopter maps its outputs 0 and 1 to: MOT_SPIN_MIN and MOT_SPIN_MAX."""
PARAMETERS_FILE, OUTPUT_FILE = "cognitivedrone.parm", "arducopter.log"
FIRST_PORT, PORT_STEP = 5760, 10
"""TCP port of the first autopilot, and from one instance to the next."""
START_S = 60.0
"""For the process to open its port, s."""
_END_S = 5.0


def find_binary(named: Path | None, way_out: str) -> Path:
    """The binary that is named, or that the environment variable `ARDUCOPTER` names.

    `way_out` ends the sentence of the `LinkError` where there is none, or it cannot be run: how to name one.
    """
    named = named or (Path(os.environ[BINARY_VARIABLE]) if os.environ.get(BINARY_VARIABLE) else None)
    if named is None:
        raise LinkError(
            f"--link sitl needs an ArduCopter binary: {way_out}; docs/vehicles.md says how to build and fly it"
        )
    if not (named.is_file() and os.access(named, os.X_OK)):
        raise LinkError(f"{named} is not a program that can be run: {way_out}")
    return named.resolve()


def tuning(airframe: Airframe) -> str:
    """Lines of parameters with which ArduCopter flies an airframe as it flies the Iris.

    The gains of the Iris are ArduCopter's own but for yaw. With another airframe a unit of output does more or less to
    it, and the gains are less or more by as much.
    """
    roll, yaw, climb = (of_iris / of_this for of_iris, of_this in zip(_effects(IRIS), _effects(airframe), strict=True))
    gains = {f"ATC_RAT_{axis}_{name}": g * roll for axis in ("RLL", "PIT") for name, g in _ROLL_GAINS.items()}
    gains |= {f"ATC_RAT_YAW_{name}": g * yaw for name, g in _YAW_GAINS.items()}
    gains |= {f"PSC_ACCZ_{name}": g * climb for name, g in _CLIMB_GAINS.items()}
    hover, _ = _at_hover(airframe)
    values = with_both_names({"MOT_THST_HOVER": hover, **gains})  # the binary's version is not known before it runs
    return "".join(f"{name} {value:.6g}\n" for name, value in values.items())


_ROLL_GAINS = {"P": 0.135, "I": 0.135, "D": 0.0036}
_YAW_GAINS = {"P": 1.0, "I": 0.1}
_CLIMB_GAINS = {"P": 0.5, "I": 1.0}


def _at_hover(airframe: Airframe) -> tuple[float, float]:
    """ArduCopter's output at hover, 0 to 1, and what a unit more of it does there to a rotor's share of thrust.

    ArduCopter undoes the curve between motor command and thrust as if it began at MOT_SPIN_MIN; the plant's begins at
    0, so the two only nearly cancel.
    """
    linear, square = LINEAR_THRUST, 1 - LINEAR_THRUST
    command = (math.sqrt(linear**2 + 4 * square / airframe.thrust_to_weight) - linear) / (2 * square)
    undone = (command - SPIN_MIN) / (SPIN_MAX - SPIN_MIN)
    steepness = (SPIN_MAX - SPIN_MIN) * (linear + 2 * square * command) / (linear + 2 * square * undone)
    return linear * undone + square * undone**2, steepness


def _effects(airframe: Airframe) -> tuple[float, float, float]:
    """What a unit of output does at hover, about roll, about yaw and upwards, but for factors that all have."""
    _, steepness = _at_hover(airframe)
    force = airframe.max_thrust * steepness
    roll, _, yaw = airframe.inertia
    return force * airframe.rotor_offset / roll, force * airframe.torque_ratio / yaw, force / airframe.mass


def port_is_free(instance: int) -> bool:
    """Whether the TCP port of an instance can be had."""
    with socket.socket() as probe:
        # As ArduCopter asks for it: a port whose last connection has only just ended can be had.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", FIRST_PORT + PORT_STEP * instance))
        except OSError:
            return False
        return True


class ArduCopter:
    """A running process. Use it as a context manager, or call `close`, which ends it and all that it started.

    `folder` is where it leaves its files, and what it prints in `arducopter.log`. It has `defaults`, parameter files,
    then what our plant and `airframe` need, then the lines in `parameters`. `speed` is how many times as fast as the
    wall clock it flies at most. It has a session of its own: ctrl-C is for us, and lands the drone before the autopilot
    may end. Raises `LinkError` where it cannot be started.
    """

    def __init__(
        self,
        binary: Path,
        folder: Path,
        *,
        instance: int = 0,
        defaults: Sequence[Path] = (),
        airframe: Airframe = IRIS,
        parameters: str = "",
        speed: float = 1.0,
    ) -> None:
        missing = [path for path in defaults if not path.is_file()]
        if missing:
            raise LinkError(f"there is no parameter file {missing[0]}")
        # ArduCopter takes its parameter files as one list.
        if unfit := [path for path in (*defaults, folder) if "," in str(path.resolve())]:
            raise LinkError(f"the path of {unfit[0]} has a comma, at which ArduCopter parts names; rename or move it")
        self.binary = binary
        self.url = f"tcp:127.0.0.1:{FIRST_PORT + PORT_STEP * instance}"
        """Where it listens for MAVLink; it starts with the first connection."""
        self.output = folder.resolve() / OUTPUT_FILE
        ours = folder.resolve() / PARAMETERS_FILE
        replace_file(ours, (PARAMETERS + tuning(airframe) + parameters).encode())
        options = {
            "model": "JSON:127.0.0.1",
            "instance": f"{instance}",
            "speedup": f"{speed:g}",
            "defaults": ",".join(str(path) for path in (*(path.resolve() for path in defaults), ours)),
        }
        command = [str(binary), *(word for name, value in options.items() for word in (f"--{name}", value))]
        try:
            with create(self.output) as file:
                self._process = subprocess.Popen(  # noqa: S603
                    system.ending_with_us(command),
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    **system.own_session(),
                )
        except OSError as error:
            raise LinkError(f"cannot run {binary}: {error.strerror}") from None

    def __enter__(self) -> ArduCopter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def check(self) -> None:
        """Raise `LinkError`, with its last line of output, where the process has ended."""
        code = self._process.poll()
        if code is not None:
            raise LinkError(f"{self.binary} ended with {code}{self.last_words()}")

    def last_words(self) -> str:
        """The last line that it printed, as a clause to end an error with."""
        with open_regular(self.output) as file:
            printed = [line.strip() for line in file.read().decode(errors="replace").split("\n") if line.strip()]
        return f", its last line of output: {printed[-1]}" if printed else ""

    def connect(self, make: Callable[[str], T]) -> T:
        """What `make(url)` makes, tried again while it raises `LinkError` and the process is still opening its port."""
        deadline = time.monotonic() + START_S
        while True:
            try:
                return make(self.url)
            except LinkError as error:
                self.check()
                if time.monotonic() > deadline:
                    raise LinkError(f"{error}{self.last_words()}") from None
                time.sleep(0.1)

    def close(self) -> None:
        """End it: ask, then kill what is left."""
        system.tell_session(self._process.pid, "TERM")
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        system.tell_session(self._process.pid, "KILL")
        self._process.wait()
