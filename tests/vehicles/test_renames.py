"""ArduCopter 4.7 renamed, rescaled and inverted parameters that safety rests on: each vehicle in its own words."""

from dataclasses import replace

import pytest
from peer import PARAMETERS, PARAMETERS_4_7, SURE, connect, playing

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.autopilot import RENAMED, with_both_names

IN_BETWEEN = {
    **{n: v for n, v in PARAMETERS_4_7.items() if not n.startswith("RTL_")},
    **{n: v for n, v in PARAMETERS.items() if n.startswith("RTL_")},
}
"""A development build of 4.7: some of the new names, some of the old."""


@pytest.mark.parametrize(
    ("version", "parameters"),
    [((4, 6), PARAMETERS), ((4, 7), PARAMETERS_4_7), ((4, 8), PARAMETERS_4_7), ((4, 7), IN_BETWEEN),
     ((0, 0), PARAMETERS_4_7)],
)  # fmt: skip
def test_a_vehicle_is_judged_by_its_own_names_and_a_release_is_not_asked_for_those_of_another(version, parameters):
    with playing(version=version, parameters=dict(parameters)) as peer:
        with connect(peer) as drone:
            checklist = drone.checklist()
        asked = {message.param_id for message in peer.of("PARAM_REQUEST_READ")}
    assert not checklist.bad
    assert {finding.what for finding in checklist.findings} >= set(parameters)
    assert "not known to the vehicle" not in str(checklist)
    released = version != (0, 0) and parameters is not IN_BETWEEN
    assert (asked == set(parameters)) == released


def test_what_is_set_with_consent_is_set_and_put_back_under_the_new_name():
    before = {**PARAMETERS_4_7, "MAV_GCS_SYSID": 7.0, "ARMING_SKIPCHK": 1048062.0}
    with playing(version=(4, 7), parameters=dict(before)) as peer:
        with (
            connect(peer) as drone,
            pytest.raises(LinkError, match=r"--set-parameters sets MAV_GCS_SYSID, ARMING_SKIP"),
        ):
            drone.take_off(lambda _: True)
        assert peer.of("PARAM_SET") == []
        with connect(peer, replace(SURE, set_parameters=True)) as drone:
            assert not drone.checklist().bad
            assert peer.part.parameters == PARAMETERS_4_7
        assert peer.part.parameters == before


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
