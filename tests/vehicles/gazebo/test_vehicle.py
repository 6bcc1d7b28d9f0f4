"""The exported Iris: the airframe's mass, inertia, thrust and motor order, and nothing of it before its camera."""

import math

import numpy as np
import pytest
from sdf_reading import element_pose, parse, values

from cognitivedrone.sim.airframe import IRIS, ROTORS
from cognitivedrone.sim.drawing.views import FIELD_OF_VIEW, MOUNT
from cognitivedrone.vehicles.gazebo.flight import VEHICLE
from cognitivedrone.vehicles.gazebo.worlds.sdf import STEP_S, document
from cognitivedrone.vehicles.gazebo.worlds.vehicle import ground_clearance, iris, parameters
from cognitivedrone.vehicles.mavlink.client.preflight import EXPECTED
from cognitivedrone.world.appearance import PLAIN


@pytest.fixture(scope="module")
def vehicle():
    return parse(document(iris((1.0, 2.0), 0.5, PLAIN))).find("model")


def plugins(vehicle, name: str):
    return [plugin for plugin in vehicle.findall("plugin") if plugin.get("name") == name]


def test_it_stands_on_the_floor_where_it_should(vehicle):
    x, y, z, roll, pitch, yaw = values(vehicle, "pose")
    assert (x, y, roll, pitch, yaw) == (1.0, 2.0, 0.0, 0.0, 0.5)
    (hull,) = vehicle.iterfind(".//collision")
    assert z == pytest.approx(values(hull, "geometry/box/size")[2] / 2)
    assert z == pytest.approx(ground_clearance(IRIS))


def test_mass_and_inertia_of_all_links_together_are_the_airframes(vehicle):
    mass, inertia = 0.0, np.zeros((3, 3))
    for link in vehicle.findall("link"):
        own = float(link.findtext("inertial/mass"))
        place = element_pose(link)[:3, 3]
        moments = np.diag([float(link.findtext(f"inertial/inertia/{axis}")) for axis in ("ixx", "iyy", "izz")])
        assert (np.diag(moments) > 0).all()
        if link.get("name").startswith("rotor"):  # it turns: over a turn, both of its long axes see the mean
            moments[0, 0] = moments[1, 1] = (moments[0, 0] + moments[1, 1]) / 2
        mass += own
        inertia += moments + own * (place @ place * np.eye(3) - np.outer(place, place))
    assert mass == pytest.approx(IRIS.mass)
    assert inertia == pytest.approx(np.diag(IRIS.inertia), abs=1e-8)


def test_a_rotor_at_full_speed_gives_the_airframes_thrust_and_torque_the_right_way_round(vehicle):
    (ardupilot,) = plugins(vehicle, "ArduPilotPlugin")
    controls = {control.findtext("jointName"): control for control in ardupilot.findall("control")}
    blades = plugins(vehicle, "gz::sim::systems::LiftDrag")
    assert len(blades) == 8
    for index, (forward, left, torque_sign) in enumerate(ROTORS):
        control = controls[f"rotor_{index}_joint"]
        assert control.get("channel") == str(index)
        place = element_pose(vehicle.find(f"link[@name='rotor_{index}']"))[:3, 3]
        assert place == pytest.approx([forward * IRIS.rotor_offset, left * IRIS.rotor_offset, 0.0])
        omega = np.array([0.0, 0.0, float(control.findtext("multiplier"))])
        force, torque = np.zeros(3), np.zeros(3)
        for blade in (blade for blade in blades if blade.findtext("link_name") == f"rotor_{index}"):
            arm = np.array(values(blade, "cp"))
            speed = np.cross(omega, arm)
            assert speed @ values(blade, "forward") == pytest.approx(np.linalg.norm(speed))  # never backwards
            number = {tag: float(blade.findtext(tag)) for tag in ("a0", "cla", "cda", "area", "air_density")}
            pressure = number["air_density"] * (speed @ speed) / 2 * number["area"] * number["a0"]
            lift = pressure * number["cla"] * np.array(values(blade, "upward"))
            drag = -pressure * number["cda"] * speed / np.linalg.norm(speed)
            force += lift + drag
            torque += np.cross(arm, lift + drag)
        assert force == pytest.approx([0, 0, IRIS.max_thrust], rel=1e-6, abs=1e-6)
        assert torque == pytest.approx([0, 0, torque_sign * IRIS.torque_ratio * IRIS.max_thrust], rel=1e-6, abs=1e-6)
        assert np.sign(torque[2]) == torque_sign


def test_ardupilot_keeps_the_time_and_gets_an_imu_in_its_own_axes(vehicle):
    (ardupilot,) = plugins(vehicle, "ArduPilotPlugin")
    assert ardupilot.findtext("lock_step") == "1"
    assert ardupilot.findtext("no_time_sync") == "0"
    link, sensor = ardupilot.findtext("imuName").split("::")
    imu = vehicle.find(f"link[@name='{link}']/sensor[@name='{sensor}']")
    assert imu.get("type") == "imu"
    assert imu.find("topic") is None
    assert element_pose(imu)[:3, :3] == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-8)
    assert values(imu, "update_rate")[0] >= 1 / STEP_S
    roll, pitch, yaw = values(ardupilot, "gazeboXYZToNED")[3:]
    assert (roll, pitch, yaw) == pytest.approx((math.pi, 0.0, math.pi / 2))


def test_the_camera_sees_nothing_of_its_own_vehicle(vehicle):
    lens = math.tan(FIELD_OF_VIEW / 2)
    points = []
    for visual in vehicle.iterfind("link/visual"):
        if visual.find("geometry/box") is not None:
            half = np.array(values(visual, "geometry/box/size")) / 2
            corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        else:
            radius = values(visual, "geometry/cylinder/radius")[0]
            angles = np.linspace(0, 2 * np.pi, 64)
            corners = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles])
        link = next(link for link in vehicle.findall("link") if visual in link.findall("visual"))
        matrix = element_pose(link) @ element_pose(visual)
        points.append(corners @ matrix[:3, :3].T + matrix[:3, 3])
    ahead, left, up = (np.concatenate(points) - MOUNT).T
    assert (ahead > 0).any()
    assert not ((ahead > 0) & (np.abs(left) < lens * ahead) & (np.abs(up) < lens * ahead)).any()


def test_the_parameters_fit_the_vehicle_and_pass_the_checks_before_flight(vehicle):
    output = dict(line.split() for line in parameters().splitlines())
    (ardupilot,) = plugins(vehicle, "ArduPilotPlugin")
    for control in ardupilot.findall("control"):
        assert (output["MOT_PWM_MIN"], output["MOT_PWM_MAX"]) == (
            control.findtext("servo_min"),
            control.findtext("servo_max"),
        )
    assert float(output["MOT_THST_HOVER"]) == pytest.approx(1 / IRIS.thrust_to_weight, abs=0.01)
    values: dict[str, float | None] = {
        expected.name: float(output[expected.name]) if expected.name in output else None
        for expected in EXPECTED["ArduCopter"]
    }
    for expected in EXPECTED["ArduCopter"]:
        if VEHICLE.only and expected.name in VEHICLE.only:
            assert expected.judge(values[expected.name] or 0.0, values, VEHICLE.ceiling_m) == "ok"
