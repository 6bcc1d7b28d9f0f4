"""Parameters are set under the vehicle's own names, and put back after the flight, whatever ends it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from peer import PARAMETERS, PARAMETERS_4_7, SURE, connect, playing

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.autopilot import RENAMED, with_both_names
from cognitivedrone.vehicles.mavlink.client.parameters import ParameterChanges, journal_of, vehicle_key


class Table:
    """A vehicle's parameters."""

    def __init__(self, **values: float) -> None:
        self.values: dict[str, float | None] = dict(values)
        self.set: list[tuple[str, float]] = []
        self.deaf = False

    def parameters(self, names):
        return {name: None if self.deaf else self.values.get(name) for name in names}

    def set_parameter(self, name, value):
        self.send_parameter(name, value)
        if self.deaf:
            raise LinkError("no answer")

    def send_parameter(self, name, value):
        self.set.append((name, value))
        if not self.deaf:
            self.values[name] = value

    def reported_parameter(self, name):
        return self.values.get(name)


BEFORE = {"FS_GCS_ENABLE": 0.0, "FS_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0}
WANTED = {"FS_GCS_ENABLE": 5.0, "FS_OPTIONS": 16.0, "GUID_TIMEOUT": 0.3}


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    return tmp_path / "new" / "vehicle.json"


@pytest.fixture
def changed(journal: Path) -> tuple[ParameterChanges, Table]:
    table, changes = Table(**BEFORE), ParameterChanges(journal)
    changes.make(table, dict(BEFORE), WANTED)
    assert table.values == WANTED
    return changes, table


def test_all_is_put_back(changed, journal):
    changes, table = changed
    assert changes.put_back(table) == ()
    assert table.values == BEFORE
    assert not journal.exists()
    assert changes.put_back(table) == ()


@pytest.mark.parametrize("second", [{}, {"GUID_TIMEOUT": 0.2}])
def test_a_killed_flight_is_put_back_at_the_next_start_and_by_a_second_flight(changed, journal, second):
    _, table = changed
    again = ParameterChanges(journal)
    assert set(again.open) == set(WANTED)
    if second:
        again.make(table, dict(WANTED), second)
    again.put_back(table)
    assert table.values == BEFORE


def test_the_journal_is_written_before_anything_is_set(journal):
    class Dying(Table):
        def set_parameter(self, name, value):
            assert json.loads(journal.read_text())[name] == [BEFORE[name], WANTED[name]]
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ParameterChanges(journal).make(Dying(**BEFORE), dict(BEFORE), WANTED)


def test_what_somebody_changed_meanwhile_stays_theirs(changed):
    changes, table = changed
    table.values["FS_GCS_ENABLE"] = 1.0
    changes.put_back(table)
    assert table.values == {**BEFORE, "FS_GCS_ENABLE": 1.0}


def test_while_the_pilot_flies_only_what_acts_by_itself_goes(changed, journal):
    changes, table = changed
    changes.put_back_meanwhile(table, 10.0, flying=True)
    assert table.values == {**WANTED, "FS_GCS_ENABLE": 0.0}
    changes.put_back_meanwhile(table, 10.1, flying=True)
    assert set(changes.open) == {"FS_OPTIONS", "GUID_TIMEOUT"}
    assert set(json.loads(journal.read_text())) == {"FS_OPTIONS", "GUID_TIMEOUT"}
    # The program ends in the air: the rest is left for the next start.
    assert set(changes.put_back(table, flying=True)) == {"FS_OPTIONS", "GUID_TIMEOUT"}
    changes.put_back_meanwhile(table, 20.0, flying=False)
    changes.put_back_meanwhile(table, 20.1, flying=False)
    assert table.values == BEFORE
    assert not journal.exists()


def test_it_is_said_again_but_not_without_end(changed):
    changes, table = changed
    table.deaf, table.set = True, []
    for step in range(60):
        changes.put_back_meanwhile(table, 10.0 + step * 0.02, flying=True)
    assert table.set == [("FS_GCS_ENABLE", 0.0)] * 3
    assert set(changes.put_back(table)) == set(WANTED)
    assert set(changes.open) == set(WANTED)


def test_a_vehicle_that_ends_with_the_program_keeps_nothing():
    changes, table = ParameterChanges(None), Table(**BEFORE)
    changes.make(table, dict(BEFORE), WANTED)
    assert changes.put_back(table) == ()
    assert table.values == WANTED


def test_a_journal_that_cannot_be_written_changes_nothing(tmp_path):
    table, changes = Table(**BEFORE), ParameterChanges(tmp_path / "folder" / "vehicle.json")
    (tmp_path / "folder").write_text("a file")
    with pytest.raises(LinkError, match="cannot write"):
        changes.make(table, dict(BEFORE), WANTED)
    assert table.values == BEFORE


def test_a_vehicle_is_known_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert vehicle_key(0, [0] * 18, 1, "udp:a") != vehicle_key(0, [0] * 18, 1, "udp:b")
    assert vehicle_key(7, [0] * 18, 1, "udp:a") == vehicle_key(7, [0] * 18, 1, "udp:b")
    assert vehicle_key(7, [1] * 18, 1, "udp:a") == vehicle_key(8, [1] * 18, 1, "udp:b")
    assert journal_of("../x").parent == tmp_path / "cognitivedrone" / "parameters"


def test_who_waits_and_who_listens_do_not_get_in_each_others_way(changed):
    """The listening thread puts back too, while somebody waits for the vehicle's answer."""
    changes, table = changed

    class Listening(Table):
        def parameters(self, names):
            changes.put_back_meanwhile(table, 50.0, flying=False)
            changes._open.pop("FS_GCS_ENABLE", None)
            return super().parameters(names)

    both = Listening()
    both.values = table.values
    assert changes.put_back(both) == ()
    assert table.values == BEFORE


@pytest.mark.parametrize(
    "content",
    [
        '{"FENCE_ENABLE": [NaN, 1]}', '{"FENCE_ENABLE": [1, Infinity]}', '{"FENCE_ENABLE": [1e999, 1]}',
        '{"FENCE_ENABLE": [' + "9" * 400 + ', 1]}', '{"../x": [1, 2]}', '{"": [1, 2]}', '{"A B": [1, 2]}',
        '{"THIS_NAME_IS_TOO_LONG": [1, 2]}', '{"FENCE_ENABLE": [1]}', '{"FENCE_ENABLE": 1}', "[1]",
        '{"FENCE_ENABLE": [1, "x"]}', "[" * 100000, "\x00", "", '"',
    ],
)  # fmt: skip
def test_a_journal_that_cannot_be_read_or_has_values_that_no_vehicle_has_is_reported(journal, content):
    journal.parent.mkdir()
    journal.write_text(content)
    with pytest.raises(LinkError, match=r"cannot read .*vehicle\.json.*check them with a ground station, then remove"):
        ParameterChanges(journal)


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
