"""Airframes and their MuJoCo model: a rigid body, four rotors with lag, and a floor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from cognitivedrone.errors import AirframeError, did_you_mean
from cognitivedrone.world.engine import mujoco

GRAVITY = 9.81
"""m/s2, downwards."""

ROTORS = ((1, -1, -1), (-1, 1, -1), (1, 1, 1), (-1, -1, 1))
"""Signs of position forward, position left and reaction torque, in ArduPilot's quad-X order: front right, rear left,
front left, rear right."""


@dataclass(frozen=True, slots=True)
class Airframe:
    """A quad-X airframe. Rotor thrust follows its command, in newtons, with a first-order lag.

    A real rotor's thrust is a curve of the motor command, which autopilots compensate. So here the command is the
    desired thrust itself.
    """

    mass: float
    """kg."""
    inertia: tuple[float, float, float]
    """Principal moments about body x, y, z, kg m2."""
    arm: float
    """Centre to rotor axis, m."""
    max_thrust: float
    """Maximum thrust of one rotor, N."""
    torque_ratio: float
    """Reaction torque over thrust of a rotor, m."""
    motor_lag: float
    """Time constant of rotor thrust, s."""
    linear_drag: float
    """N per m/s of velocity relative to the air."""
    quadratic_drag: float
    """N per (m/s)2."""
    angular_damping: float
    """N m per rad/s."""
    hull_radius: float
    """Radius of the sphere that must not touch a gate, m."""

    @property
    def thrust_to_weight(self) -> float:
        """Thrust of all four rotors over weight."""
        return 4 * self.max_thrust / (self.mass * GRAVITY)

    @property
    def rotor_offset(self) -> float:
        """Distance of a rotor from the body's x and y axes, m."""
        return self.arm / math.sqrt(2)


RACER = Airframe(
    mass=0.7,
    inertia=(0.0025, 0.0025, 0.0043),
    arm=0.11,
    max_thrust=8.6,
    torque_ratio=0.014,
    motor_lag=0.025,
    linear_drag=0.12,
    quadratic_drag=0.01,
    angular_damping=0.0004,
    hull_radius=0.13,
)
"""A 5-inch racing quadrotor (thrust to weight 5). Inertia and torque ratio follow the Agilicious airframe
(Foehn et al., Science Robotics 2022); drag per mass is close to the Iris's."""

IRIS = Airframe(
    mass=1.5,
    inertia=(0.029, 0.029, 0.055),
    arm=0.25,
    max_thrust=10.9,
    torque_ratio=0.02,
    motor_lag=0.03,
    linear_drag=0.25,
    quadratic_drag=0.02,
    angular_damping=0.004,
    hull_radius=0.28,
)
"""The 1.5 kg quadrotor of ArduPilot's and Gazebo's simulations, thrust to weight 2.96."""

AIRFRAMES: dict[str, Airframe] = {"racer": RACER, "iris": IRIS}


def find_airframe(name: str) -> Airframe:
    """The airframe of that name. Raises `AirframeError` where there is none."""
    if name not in AIRFRAMES:
        raise AirframeError(f"unknown airframe {name!r}; {did_you_mean(str(name), AIRFRAMES)}")
    return AIRFRAMES[name]


def build_model(airframe: Airframe, timestep: float) -> Any:
    """`mujoco.MjModel` of one airframe over a floor at z = 0.

    State: a free joint (qpos: position, quaternion; qvel: world velocity, body rates) and one activation per rotor, its
    thrust in N. ctrl: thrust commands in N, in the order of `ROTORS`. Only the floor has collisions.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # report a diverged world instead of resetting it
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    body = spec.worldbody.add_body(name="drone", pos=[0, 0, 1])
    body.explicitinertial = True
    body.ipos = [0, 0, 0]
    body.mass = airframe.mass
    body.inertia = airframe.inertia
    body.add_freejoint(name="drone")
    side = airframe.rotor_offset
    body.add_geom(name="hull", type=mujoco.mjtGeom.mjGEOM_BOX, size=[side, side, 0.3 * side])
    for index, (forward, left, torque) in enumerate(ROTORS):
        body.add_site(name=f"rotor{index}", pos=[forward * side, left * side, 0])
        spec.add_actuator(
            name=f"rotor{index}",
            trntype=mujoco.mjtTrn.mjTRN_SITE,
            target=f"rotor{index}",
            gear=[0, 0, 1, 0, 0, torque * airframe.torque_ratio],
            dyntype=mujoco.mjtDyn.mjDYN_FILTEREXACT,
            dynprm=[airframe.motor_lag] + [0.0] * 9,
            ctrllimited=True,
            ctrlrange=[0, airframe.max_thrust],
        )
    model = spec.compile()
    model.dof_damping[3:6] = airframe.angular_damping
    return model
