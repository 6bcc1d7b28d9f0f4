"""The Iris of `sim/airframe.py` as an SDF model: body, four rotors, camera, IMU, and the ArduPilot plugin.

Rotor thrust is the lift of two blades, as gz-sim's LiftDrag system computes it: rho v^2 / 2 times area times lift
coefficient, with v the speed of the blade's centre of pressure. Area and drag coefficient are chosen such that a rotor
at full speed gives the airframe's maximum thrust and reaction torque.

ArduPilotPlugin: parameters as in https://github.com/ArduPilot/ardupilot_gazebo. It answers ArduPilot in lock-step and
forwards the IMU's data unchanged, so the IMU is rotated to forward-right-down.
"""

from __future__ import annotations

import math
from typing import Final
from xml.etree import ElementTree as ET

from cognitivedrone.sim.airframe import GRAVITY, IRIS, ROTORS, Airframe
from cognitivedrone.sim.drawing.views import FIELD_OF_VIEW, MOUNT
from cognitivedrone.types import IMAGE_SIZE
from cognitivedrone.vehicles.gazebo.worlds.sdf import Fields, fill, material, new, paint
from cognitivedrone.world.appearance import RGB, Appearance

NAME: Final = "iris"
CAMERA_TOPIC: Final = "/cognitivedrone/camera"
CAMERA_HZ: Final = 20
"""Twice the control rate: the newest frame is never older than half a control step."""
IMU_HZ: Final = 1000
PORT: Final = 9002
"""UDP port on which the first ArduPilot instance expects its physics."""
PWM_RANGE_US: Final = (1000, 2000)
"""A disarmed ArduPilot sends 1000; with a larger minimum the rotors would turn backwards."""
FULL_SPEED: Final = 838.0
"""Maximum rotor speed, rad/s."""

_AIR_DENSITY = 1.2041  # kg/m3
_PRESSURE_CENTER = 0.084  # m from the hub
_ATTACK_ANGLE, _LIFT_SLOPE = 0.3, 4.25  # rad; lift coefficient per rad
_ROTOR_MASS, _ROTOR_RADIUS, _ROTOR_HEIGHT = 0.025, 0.1, 0.01  # kg, m, m
_ROTOR_INERTIA = (9.75e-6, 1.67e-4, 1.67e-4)  # of a two-bladed propeller, kg m2
_NEAR, _FAR = 0.03, 200.0  # m, as in our world
_ALL_VISIBLE = 0x3FFFFFFF  # ogre2 has uses of its own for the two highest bits, and warns of the default, all 32
_DARK: RGB = (0.15, 0.15, 0.17)
_FRONT: RGB = (1.0, 0.55, 0.0)
_REAR: RGB = (0.35, 0.35, 0.4)
_GLOW = 0.2


def iris(position: tuple[float, float], yaw: float, appearance: Appearance, airframe: Airframe = IRIS) -> ET.Element:
    """The `<model>` of the vehicle, on the ground at world x, y (m), with heading `yaw` (rad).

    From the appearance only the camera's pixel noise is used; SDF cannot express its response curve and gain.
    """
    model = new("model", {"pose": (*position, ground_clearance(airframe), 0.0, 0.0, yaw)}, name=NAME)
    base = fill(ET.SubElement(model, "link", name="base_link"), _inertial(*_body(airframe)))
    side = airframe.rotor_offset
    hull = (2 * side, 2 * side, 2 * ground_clearance(airframe))
    base.append(new("collision", {"geometry": {"box": {"size": hull}}}, name="hull"))
    for number, quarter in enumerate((1, -1), start=1):
        shape = {"geometry": {"box": {"size": (2 * airframe.arm, 0.03, 0.02)}}}
        arm = new("visual", {"pose": (0, 0, 0, 0, 0, quarter * math.pi / 4), **shape}, name=f"arm_{number}")
        arm.append(material(paint(_DARK, _GLOW, appearance)))
        base.append(arm)
    # No explicit topic: ArduPilotPlugin subscribes to the one that Gazebo generates.
    imu: Fields = {"pose": (0, 0, 0, math.pi, 0, 0), "always_on": "true", "update_rate": IMU_HZ}
    base.append(new("sensor", imu, name="imu_sensor", type="imu"))
    base.append(_camera(appearance))
    for index, (forward, left, _) in enumerate(ROTORS):
        model.extend(_rotor(index, forward * side, left * side, appearance))
    for index, (_, _, torque) in enumerate(ROTORS):
        for blade in (1, -1):
            model.append(_blade(airframe, index, turning=-torque, blade=blade))
    model.append(_ardupilot())
    return model


def parameters(airframe: Airframe = IRIS) -> str:
    """The parameter file that adapts ArduCopter's defaults to this vehicle.

    The thrust of Gazebo's rotors is proportional to the square of the command (MOT_THST_EXPO 1), over the whole PWM
    range. The checklist requires the last two parameters.
    """
    hover = airframe.mass * GRAVITY / (4 * airframe.max_thrust)
    values = {
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 1,
        "MOT_PWM_MIN": PWM_RANGE_US[0],
        "MOT_PWM_MAX": PWM_RANGE_US[1],
        "MOT_THST_EXPO": 1,
        "MOT_THST_HOVER": round(hover, 2),
        "ATC_RAT_YAW_P": 1.0,
        "ATC_RAT_YAW_I": 0.1,
        "ATC_RAT_YAW_FLTE": 10,
        "AHRS_EKF_TYPE": 3,
        "GUID_TIMEOUT": 1,
        "FS_GCS_ENABLE": 5,
    }
    return "".join(f"{name} {value}\n" for name, value in values.items())


def ground_clearance(airframe: Airframe = IRIS) -> float:
    """Height of the vehicle's origin above the floor when landed, m, from the hull in `sim/airframe.py`."""
    return 0.3 * airframe.rotor_offset


def _body(airframe: Airframe) -> tuple[float, tuple[float, float, float]]:
    """Mass and principal moments of the body without rotors, such that the total matches the airframe."""
    side = airframe.rotor_offset
    lever = (side**2, side**2, 2 * side**2)
    own = ((_ROTOR_INERTIA[0] + _ROTOR_INERTIA[1]) / 2,) * 2 + (_ROTOR_INERTIA[2],)  # averaged over a turn
    x, y, z = (
        whole - 4 * (_ROTOR_MASS * arm + spin) for whole, arm, spin in zip(airframe.inertia, lever, own, strict=True)
    )
    return airframe.mass - 4 * _ROTOR_MASS, (x, y, z)


def _inertial(mass: float, moments: tuple[float, float, float]) -> Fields:
    inertia = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (*moments, 0.0, 0.0, 0.0), strict=True)
    return {"inertial": {"mass": mass, "inertia": dict(inertia)}}


def _camera(appearance: Appearance) -> ET.Element:
    image: Fields = {"width": IMAGE_SIZE, "height": IMAGE_SIZE, "format": "R8G8B8"}
    noise: Fields = {"noise": {"type": "gaussian", "mean": 0, "stddev": appearance.noise / 255}}
    camera: Fields = {
        "horizontal_fov": FIELD_OF_VIEW,
        "image": image,
        "visibility_mask": str(_ALL_VISIBLE),
        "clip": {"near": _NEAR, "far": _FAR},
        **(noise if appearance.noise > 0.0 else {}),
    }
    sensor: Fields = {
        "pose": (*MOUNT, 0, 0, 0), "always_on": "true", "update_rate": CAMERA_HZ, "topic": CAMERA_TOPIC,
        "camera": camera,
    }  # fmt: skip
    return new("sensor", sensor, name="camera", type="camera")


def _rotor(index: int, forward: float, left: float, appearance: Appearance) -> tuple[ET.Element, ET.Element]:
    """A link with a disc, and its revolute joint."""
    name = f"rotor_{index}"
    link = new("link", {"pose": (forward, left, 0, 0, 0, 0), **_inertial(_ROTOR_MASS, _ROTOR_INERTIA)}, name=name)
    cylinder: Fields = {"radius": _ROTOR_RADIUS, "length": _ROTOR_HEIGHT}
    disc = new("visual", {"geometry": {"cylinder": cylinder}}, name="disc")
    disc.append(material(paint(_FRONT if forward > 0 else _REAR, _GLOW, appearance)))
    link.append(disc)
    axis: Fields = {"xyz": (0, 0, 1), "limit": {"lower": "-1e16", "upper": "1e16"}}
    joint: Fields = {"parent": "base_link", "child": name, "axis": axis}
    return link, new("joint", joint, name=f"{name}_joint", type="revolute")


def _blade(airframe: Airframe, index: int, turning: int, blade: int) -> ET.Element:
    """Lift and drag of one blade, `blade` 1 or -1; `turning` is 1 for counter-clockwise rotors, -1 for clockwise."""
    pressure = _AIR_DENSITY * (FULL_SPEED * _PRESSURE_CENTER) ** 2 / 2
    fields: Fields = {
        "a0": _ATTACK_ANGLE, "alpha_stall": 1.4, "cla": _LIFT_SLOPE,
        "cda": _LIFT_SLOPE * airframe.torque_ratio / _PRESSURE_CENTER,
        "cma": 0, "cla_stall": -0.025, "cda_stall": 0, "cma_stall": 0,
        "area": airframe.max_thrust / (2 * pressure * _LIFT_SLOPE * _ATTACK_ANGLE), "air_density": _AIR_DENSITY,
        "cp": (blade * _PRESSURE_CENTER, 0, 0), "forward": (0, blade * turning, 0), "upward": (0, 0, 1),
        "link_name": f"rotor_{index}",
    }  # fmt: skip
    return new("plugin", fields, filename="gz-sim-lift-drag-system", name="gz::sim::systems::LiftDrag")


def _ardupilot() -> ET.Element:
    """The ArduPilot plugin, in lock-step: with `no_time_sync`, ArduPilot would run on without physics."""
    fields: Fields = {
        "fdm_addr": "127.0.0.1", "fdm_port_in": PORT, "connectionTimeoutMaxCount": 5, "lock_step": 1,
        "no_time_sync": 0, "have_32_channels": 0, "modelXYZToAirplaneXForwardZDown": (0, 0, 0, math.pi, 0, 0),
        "gazeboXYZToNED": (0, 0, 0, math.pi, 0, math.pi / 2), "imuName": "base_link::imu_sensor",
    }  # fmt: skip
    plugin = new("plugin", fields, filename="ArduPilotPlugin", name="ArduPilotPlugin")
    for index, (_, _, torque) in enumerate(ROTORS):
        control: Fields = {
            "jointName": f"rotor_{index}_joint", "type": "VELOCITY", "useForce": 1, "multiplier": -torque * FULL_SPEED,
            "offset": 0, "servo_min": PWM_RANGE_US[0], "servo_max": PWM_RANGE_US[1],
            "p_gain": 0.2, "i_gain": 0, "d_gain": 0, "i_max": 0, "i_min": 0, "cmd_max": 2.5, "cmd_min": -2.5,
            "controlVelocitySlowdownSim": 1,
        }  # fmt: skip
        plugin.append(new("control", control, channel=str(index)))
    return plugin
