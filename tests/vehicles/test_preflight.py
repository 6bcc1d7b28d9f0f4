"""The checklist: every row, and what blocks arming."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from peer import PARAMETERS, PARAMETERS_4_7
from px4_peer import PX4_PARAMETERS

from cognitivedrone.vehicles.checklist import Finding
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, PX4, read_by_either_name
from cognitivedrone.vehicles.mavlink.client.expected import EXPECTED
from cognitivedrone.vehicles.mavlink.client.preflight import Facts, build_checklist, corrections
from cognitivedrone.vehicles.mavlink.client.traffic import Traffic
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry

NAMES = tuple(expected.name for expected in EXPECTED["ArduCopter"])
NOW = 100.0
TELEMETRY = Telemetry(
    mode="STABILIZE",
    received_at=NOW,
    heartbeat_at=NOW,
    position=np.zeros(3),
    position_at=NOW,
    attitude_at=NOW,
    vehicle_time=30.0,
    position_time=30.0,
    attitude_time=30.0,
    clock_offset=70.0,
    battery=0.8,
    battery_at=NOW,
    status_at=NOW,
    ekf=0x33F,
    ekf_at=NOW,
    sticks=(1500, 1500, 1000, 1500),
    remote_at=NOW,
)
FACTS = Facts(
    now=NOW,
    version=(4, 6),
    values=PARAMETERS,
    changed=(),
    telemetry=TELEMETRY,
    traffic=Traffic(answered_at=NOW - 0.1),
    home=True,
    frame_age_s=0.1,
    takeoff_height_m=1.0,
    ceiling_m=10.0,
)


def states(**changes: Any) -> dict[str, str]:
    """State by row, with other values of parameters or other facts."""
    values = {name: changes.pop(name) for name in list(changes) if name in NAMES}
    telemetry = replace(TELEMETRY, **{name: changes.pop(name) for name in list(changes) if hasattr(TELEMETRY, name)})
    facts = replace(FACTS, values={**PARAMETERS, **values}, telemetry=telemetry, **changes)
    return {finding.what: finding.state for finding in build_checklist(facts).findings}


def test_a_good_vehicle_passes_and_only_the_person_is_asked():
    assert {what for what, state in states().items() if state != "ok"} == {"you"}
    assert set(NAMES) <= set(states())


ROWS: dict[str, list[tuple[str, list[float], list[float], list[float]]]] = {
    "ArduCopter": [
        ("SYSID_MYGCS", [255], [], [250, 0, 1]),
        ("FS_GCS_ENABLE", [5, 4], [], [0, 2, 6, 7, 99]),
        ("FS_GCS_TIMEOUT", [2, 5], [], [0, 30, 120]),
        ("FS_OPTIONS", [16, 16 + 8, 16 + 3], [], [0, 8, 4, 20]),
        ("GUID_TIMEOUT", [0.1, 0.3, 1.0], [], [0, 1.1, 3, 5]),
        ("ARMING_CHECK", [1], [72], [0]),
        ("FENCE_ENABLE", [1], [], [0]),
        ("FENCE_ACTION", [1, 2, 3, 5], [], [0, 4]),
        ("BATT_FS_LOW_ACT", [1, 2], [], [0, 5, 7]),
        ("BATT_LOW_VOLT", [10.5], [0], []),
        ("RTL_ALT", [0, 1000], [1001, 1500], []),
        ("RTL_CLIMB_MIN", [0], [100], []),
        ("FS_THR_ENABLE", [1, 3], [0, 7], []),
        ("FS_EKF_ACTION", [1, 3], [2], []),
        ("FS_EKF_THRESH", [0.8], [0], []),
        ("FS_CRASH_CHECK", [1], [0], []),
    ],
    "PX4": [
        ("COM_OBL_RC_ACT", [3, 4], [], [0, 1, 2, 5, 6, 7]),
        ("COM_OF_LOSS_T", [0.5, 1.0], [], [0.0, 0.3, 1.5, 60.0]),
        ("COM_RCL_EXCEPT", [0, 3], [], [4, 7]),
        ("NAV_DLL_ACT", [0], [1, 2, 3], [5, 6]),
        ("GF_ACTION", [3, 5], [], [0, 1, 2, 4]),
        ("GF_MAX_HOR_DIST", [100.0], [0.0], []),
        ("GF_MAX_VER_DIST", [20.0], [0.0], []),
        ("COM_LOW_BAT_ACT", [2, 3], [], [0, 1]),
        ("BAT_CRIT_THR", [0.07], [0.0], []),
        ("MAV_FWDEXTSP", [1], [], [0]),
        ("COM_RC_OVERRIDE", [2, 3], [0, 1], []),
        ("COM_RC_IN_MODE", [0, 3], [4], []),
        ("NAV_RCL_ACT", [1, 2, 3], [0, 5, 6], []),
        ("COM_DL_LOSS_T", [5, 10, 300], [], []),
        ("COM_FAIL_ACT_T", [0.0, 5.0], [25.0], []),
        ("RTL_RETURN_ALT", [8.0], [60.0], []),
        ("COM_DISARM_LAND", [2.0], [-1.0], []),
    ],
}
"""By the autopilot: a parameter and its values that are good, for the person to judge, and bad."""
STOCK = {"ArduCopter": (ARDUPILOT, PARAMETERS), "PX4": (PX4, PX4_PARAMETERS)}


@pytest.mark.parametrize(
    ("autopilot", "name", "good", "warn", "bad"),
    [(autopilot, *row) for autopilot, rows in ROWS.items() for row in rows],
)
def test_each_parameter(autopilot, name, good, warn, bad):
    kind, stock = STOCK[autopilot]
    wanted = next(expected.wanted for expected in EXPECTED[autopilot] if expected.name == name)
    for state, values in (("ok", good), ("warn", warn), ("bad", bad)):
        for value in values:
            found = {**stock, name: float(value)}
            checklist = build_checklist(replace(FACTS, values=found, autopilot=kind))
            assert {row.what: row.state for row in checklist.findings}[name] == state, value
            set_to = corrections(found, 10.0, autopilot=kind)
            assert set_to.keys() == ({name} if state == "bad" and wanted is not None else set())


@pytest.mark.parametrize("autopilot", ROWS)
def test_each_parameter_is_tested(autopilot):
    assert [row[0] for row in ROWS[autopilot]] == [expected.name for expected in EXPECTED[autopilot]]


def test_a_px4_is_reported_with_its_own_reasons():
    assert list(PX4_PARAMETERS) == [expected.name for expected in EXPECTED["PX4"]]
    values = {**PX4_PARAMETERS, "COM_OBL_RC_ACT": 5}
    text = str(build_checklist(replace(FACTS, version=(1, 16), values=values, autopilot=PX4)))
    assert "PX4 1.16" in text
    assert "what it does when our velocities stop" in " ".join(text.split())
    assert "GUID_TIMEOUT" not in text


def test_a_return_of_a_px4_must_not_climb_above_our_ceiling():
    values = {**PX4_PARAMETERS, "COM_OBL_RC_ACT": 3, "RTL_RETURN_ALT": 60.0}
    assert corrections(values, 10.0, autopilot=PX4) == {"COM_OBL_RC_ACT": 4}


@pytest.mark.parametrize("name", NAMES)
def test_a_vehicle_without_a_required_parameter_is_not_flown(name):
    required = ("SYSID_MYGCS", "FS_", "GUID_TIMEOUT", "ARMING", "FENCE", "BATT_FS")
    advisory = {"FS_THR_ENABLE", "FS_EKF_ACTION", "FS_EKF_THRESH", "FS_CRASH_CHECK"}
    expected = "bad" if name.startswith(required) and name not in advisory else "warn"
    assert states(**{name: None})[name] == expected


@pytest.mark.parametrize(
    ("rtl", "climb", "state"), [(900.0, 0.0, "ok"), (1500.0, 0.0, "bad"), (900.0, 500.0, "bad"), (None, 0.0, "bad")]
)
@pytest.mark.parametrize("action", [1.0, 3.0])
def test_a_failsafe_that_returns_must_not_climb_above_our_ceiling(action, rtl, climb, state):
    assert states(FS_GCS_ENABLE=action, RTL_ALT=rtl, RTL_CLIMB_MIN=climb)["FS_GCS_ENABLE"] == state


def renamed(**values: float | None) -> dict[str, Finding]:
    """The rows of an ArduCopter 4.7, with other values of its own parameters; none where it has none."""
    has = PARAMETERS_4_7 | values
    own = read_by_either_name(lambda names: {name: has.get(name) for name in names}, NAMES, (4, 7))
    older = {name: it.older(name) for name, it in own.items()}
    checklist = build_checklist(replace(FACTS, version=(4, 7), values=older, own=own))
    return {finding.what: finding for finding in checklist.findings}


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
    row = renamed(**{name: value})[name]
    assert (row.state, row.found) == (state, f"{value:.7g}")


@pytest.mark.parametrize(("height", "state"), [(9.0, "ok"), (15.0, "bad")])
def test_a_failsafe_that_returns_is_judged_by_the_height_in_metres(height, state):
    row = renamed(FS_GCS_ENABLE=1.0, RTL_ALT_M=height)["FS_GCS_ENABLE"]
    assert row.state == state
    assert "RTL_ALT " not in row.needed + row.why


def test_a_vehicle_without_either_name_is_not_flown():
    rows = renamed(ARMING_SKIPCHK=None)
    assert [(row.what, row.found) for row in rows.values() if row.state == "bad"] == [
        ("ARMING_SKIPCHK", "not known to the vehicle")
    ]


@pytest.mark.parametrize(
    ("changes", "row", "state"),
    [
        ({"version": None}, "firmware", "warn"),
        ({"vehicle_time": 0.0}, "clock", "bad"),
        ({"position_at": NOW + 2.0}, "clock", "bad"),  # 2 s later than its own time says
        ({"position_at": NOW + 2.0, "judges_time": False}, "clock", "ok"),  # a simulation that runs slowly
        ({"heartbeat_at": NOW - 2}, "heartbeat", "bad"),
        ({"traffic": Traffic()}, "answers", "bad"),
        ({"traffic": Traffic(answered_at=NOW - 2)}, "answers", "bad"),
        ({"ekf": None}, "state estimator", "bad"),
        ({"ekf_at": NOW - 5}, "state estimator", "bad"),
        ({"ekf": 0xA7}, "state estimator", "bad"),
        ({"ekf_variances": (1.0, 1.0, 0.0, 0.0)}, "state estimator", "bad"),
        ({"ekf": 0xA7}, "position", "bad"),
        ({"position_at": -np.inf}, "position", "bad"),
        ({"home": False}, "home", "bad"),
        ({"battery": None, "status_at": -np.inf}, "battery", "bad"),
        ({"battery": None}, "battery", "bad"),
        ({"battery": 0.29}, "battery", "bad"),
        ({"sticks": ()}, "remote control", "warn"),
        ({"remote_at": NOW - 5}, "remote control", "warn"),
        ({"frame_age_s": 1.5}, "camera", "bad"),
        ({"traffic": Traffic(answered_at=NOW, ground_stations=frozenset({(250, 190)}))}, "ground station", "warn"),
        ({"traffic": Traffic(answered_at=NOW, ground_stations=frozenset({(255, 190)}))}, "ground station", "bad"),
        ({"traffic": Traffic(answered_at=NOW, commander="system 9", commander_at=NOW)}, "commander", "bad"),
        ({"traffic": Traffic(answered_at=NOW, impostor_at=NOW)}, "sender", "bad"),
    ],
)
def test_each_state(changes, row, state):
    assert states(**changes)[row] == state


def test_the_table_tells_found_and_needed_and_of_what_is_not_ok_why():
    text = str(build_checklist(replace(FACTS, values={**PARAMETERS, "FS_GCS_ENABLE": 7.0})))
    head, *rows = text.splitlines()
    assert head.split() == ["what", "found", "needed"]
    assert [row[7:20] for row in rows if row.startswith("[bad ]")] == ["FS_GCS_ENABLE"]
    assert "7 brakes and stays" in " ".join(text.split())
    assert "5 or 4" in text
    assert "16: what a pilot flies goes on" not in text
    marked = [row for row in rows if row[0] == "["]
    assert len(marked) == len(build_checklist(FACTS).findings)


@pytest.mark.parametrize(
    "facts",
    [
        FACTS,
        replace(FACTS, values=dict.fromkeys(PARAMETERS)),
        replace(
            FACTS, traffic=replace(FACTS.traffic, commander="system 9, component 190, commands the vehicle too (X)")
        ),
        replace(FACTS, values=dict.fromkeys(PARAMETERS, 1e-09), changed=tuple(PARAMETERS)),
    ],
)
def test_a_terminal_of_80_columns_shows_every_word_of_the_table(facts):
    checklist = build_checklist(facts)
    lines = str(checklist).splitlines()
    assert max(map(len, lines)) <= 80
    assert all(map(str.isprintable, lines))
    words = set(str(checklist).split())
    for finding in checklist.findings:
        output = f"{finding.what} {finding.found} {finding.needed} {'' if finding.state == 'ok' else finding.why}"
        assert words >= set(output.split())


def test_a_refusal_says_what_is_bad_and_which_option_sets_it_and_of_a_simulation_only_the_named_rows_block():
    facts = replace(FACTS, values={**PARAMETERS, "FENCE_ENABLE": 0.0}, home=False)
    checklist = build_checklist(facts)
    last = "change what is bad (home, FENCE_ENABLE), and try again"
    assert checklist.refusal(consent=False).endswith(f"\n{last}; --set-parameters sets FENCE_ENABLE for the flight")
    assert checklist.refusal(consent=True).endswith(f"\n{last}")
    assert [row.what for row in build_checklist(facts, only=("FENCE_ENABLE",)).bad] == ["FENCE_ENABLE"]


def test_what_is_set_with_consent_is_what_is_bad_and_makes_it_good():
    wrong = {name: float(bad[-1]) for name, _, _, bad in ROWS["ArduCopter"] if bad} | {"FS_OPTIONS": 12.0}
    values = {**PARAMETERS, **wrong, "RTL_ALT": 1500.0, "FS_THR_ENABLE": 0.0}
    fixed = corrections(values, 10.0)
    assert set(fixed) == set(wrong)
    assert fixed["FS_OPTIONS"] == 8 + 16  # the user's other bits stay
    assert not build_checklist(replace(FACTS, values={**values, **fixed})).bad
    assert corrections(PARAMETERS, 10.0) == {}
    assert corrections(values, 10.0, only=("FS_GCS_ENABLE",)) == {"FS_GCS_ENABLE": 5}
