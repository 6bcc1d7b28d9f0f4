"""ArduCopter 4.7 renamed, rescaled and inverted parameters that safety rests on: each vehicle in its own words."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")
sys.path.insert(0, str(Path(__file__).parent))

from peer import CALM, PARAMETERS, PARAMETERS_4_7, Peer, StillCamera, playing

from cognitivedrone.control.safety import Guard
from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.renames import RENAMED, with_both_names
from cognitivedrone.vehicles.mavlink.server.parameters import Parameters

CONFIG = MavlinkConfig(heartbeat_timeout_s=60, ready_timeout_s=60, takeoff_timeout_s=60)
IN_BETWEEN = {
    **{n: v for n, v in PARAMETERS_4_7.items() if not n.startswith("RTL_")},
    **{n: v for n, v in PARAMETERS.items() if n.startswith("RTL_")},
}
"""A development build of 4.7: some of the new names, some of the old."""


def connect(peer: Peer, config: MavlinkConfig = CONFIG) -> MavlinkDrone:
    return MavlinkDrone(f"udpout:127.0.0.1:{peer.port}", StillCamera(), Guard(CALM), config)


@pytest.mark.parametrize(
    ("version", "parameters"),
    [((4, 6), PARAMETERS), ((4, 7), PARAMETERS_4_7), ((4, 8), PARAMETERS_4_7), ((4, 7), IN_BETWEEN),
     ((0, 0), PARAMETERS_4_7)],
)  # fmt: skip
def test_a_vehicle_is_judged_by_its_own_names(version, parameters):
    with playing(version=version, parameters=dict(parameters)) as peer, connect(peer) as drone:
        checklist = drone.checklist()
    assert not checklist.bad
    assert {finding.what for finding in checklist.findings} >= set(parameters)
    assert "not known to the vehicle" not in str(checklist)


def test_a_release_is_not_asked_for_names_of_another():
    for version, parameters in (((4, 6), PARAMETERS), ((4, 7), PARAMETERS_4_7)):
        with playing(version=version, parameters=dict(parameters)) as peer:
            with connect(peer) as drone:
                drone.checklist()
            assert {message.param_id for message in peer.of("PARAM_REQUEST_READ")} == set(parameters)


@pytest.mark.parametrize(
    ("name", "value", "state"),
    [
        ("MAV_GCS_SYSID", 250.0, "bad"),
        ("ARMING_SKIPCHK", -1.0, "bad"),
        ("ARMING_SKIPCHK", 1048062.0, "bad"),  # every check by its own bit
        ("ARMING_SKIPCHK", 1048576.0, "warn"),  # a bit that the documentation does not name
        ("ARMING_SKIPCHK", 4.0, "warn"),
        ("RTL_ALT_M", 10.0, "ok"),
        ("RTL_ALT_M", 15.0, "warn"),
        ("RTL_CLIMB_MIN_M", 1.0, "warn"),
    ],
)
def test_the_new_units_and_the_new_sense(name, value, state):
    with playing(version=(4, 7), parameters={**PARAMETERS_4_7, name: value}) as peer, connect(peer) as drone:
        row = next(finding for finding in drone.checklist().findings if finding.what == name)
    assert (row.state, row.found) == (state, f"{value:.7g}")


@pytest.mark.parametrize(("height", "state"), [(9.0, "ok"), (15.0, "bad")])
def test_a_failsafe_that_returns_is_judged_by_the_height_in_metres(height, state):
    values = {**PARAMETERS_4_7, "FS_GCS_ENABLE": 1.0, "RTL_ALT_M": height}
    with playing(version=(4, 7), parameters=values) as peer, connect(peer) as drone:
        rows = {finding.what: finding for finding in drone.checklist().findings}
    assert rows["FS_GCS_ENABLE"].state == state
    assert "RTL_ALT " not in rows["FS_GCS_ENABLE"].needed + rows["FS_GCS_ENABLE"].why


def test_what_is_set_with_consent_is_set_and_put_back_under_the_new_name():
    before = {**PARAMETERS_4_7, "MAV_GCS_SYSID": 7.0, "ARMING_SKIPCHK": 1048062.0}
    with playing(version=(4, 7), parameters=dict(before)) as peer:
        with (
            connect(peer) as drone,
            pytest.raises(LinkError, match=r"--set-parameters sets MAV_GCS_SYSID, ARMING_SKIP"),
        ):
            drone.take_off(lambda _: True)
        with connect(peer, replace(CONFIG, set_parameters=True)) as drone:
            assert not drone.checklist().bad
            assert peer.part.parameters == PARAMETERS_4_7
        assert peer.part.parameters == before


def test_a_vehicle_without_either_name_is_not_flown():
    values = {name: value for name, value in PARAMETERS_4_7.items() if name != "ARMING_SKIPCHK"}
    with playing(version=(4, 7), parameters=values) as peer, connect(peer) as drone:
        assert [(row.what, row.found) for row in drone.checklist().bad] == [
            ("ARMING_SKIPCHK", "not known to the vehicle")
        ]


@pytest.mark.parametrize(("checks", "skipped"), [(1, 0), (0, -1), (3, 0), (1048062 - 4, 4), (4, 1048062 - 4)])
def test_checks_that_are_made_are_those_that_are_not_skipped(checks, skipped):
    assert RENAMED["ARMING_CHECK"].newer(checks) == skipped
    back = RENAMED["ARMING_CHECK"].older(skipped)
    assert back == (1 if checks & 1 else checks)


def test_a_parameter_file_has_both_names_each_in_its_unit():
    both = with_both_names({"RTL_ALT": 300.0, "PSC_ACCZ_P": 0.5, "FS_OPTIONS": 16.0})
    assert both == pytest.approx(
        {"RTL_ALT": 300, "RTL_ALT_M": 3, "PSC_ACCZ_P": 0.5, "PSC_D_ACC_P": 0.05, "FS_OPTIONS": 16}
    )


def test_the_simulated_vehicle_shows_the_names_and_units_of_its_version():
    old, new = Parameters(7), Parameters(7, (4, 7))
    assert {"RTL_ALT", "SYSID_THISMAV", "WPNAV_SPEED"} <= set(old)
    assert {"RTL_ALT_M", "MAV_SYSID", "WP_SPD", "ARMING_SKIPCHK"} <= set(new)
    assert not set(RENAMED) & set(new)
    assert len(old) == len(new)
    assert (new.reported("RTL_ALT_M"), new.reported("WP_SPD"), new.reported("MAV_SYSID")) == (3.0, 10.0, 7.0)
    assert new.reported("ATC_ANGLE_MAX") == pytest.approx(30.0)
    assert (new.kind("RTL_ALT_M"), old.kind("RTL_ALT"), new.kind("MAV_GCS_SYSID")) == ("float", "int16", "int16")


def test_the_simulated_vehicle_takes_values_in_the_units_of_its_version():
    new = Parameters(1, (4, 7))
    assert new.set("RTL_ALT_M", 5.5) is None
    assert new["RTL_ALT"] == pytest.approx(550.0)
    assert new.set("RTL_ALT_M", 550.0) == "RTL_ALT_M takes 0.3 to 300"
    assert new.set("ARMING_SKIPCHK", -1.0) is None
    assert new["ARMING_CHECK"] == 0
    assert new.set("ARMING_SKIPCHK", 0.0) is None
    assert new["ARMING_CHECK"] == 1
    assert new.set("ATC_ANGLE_MAX", 45.0) == "ATC_ANGLE_MAX cannot be changed here"
    assert new.set("MAV_SYSID", 2.0) == "MAV_SYSID cannot be changed here"
