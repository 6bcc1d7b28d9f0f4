"""Numbers and texts that no option can take are refused in one sentence, before any work."""

import contextlib
from typing import Annotated

import pytest

from cognitivedrone import cli
from cognitivedrone.cli import TARGETS, load, main
from cognitivedrone.errors import TaskError, UsageError
from cognitivedrone.plan import Scenario
from cognitivedrone.ranges import Count, Range, Seed, check_arguments
from cognitivedrone.tasks.suites import open_suite


@pytest.fixture
def refused(capsys, monkeypatch, tmp_path):
    """The sentence of a command that ends before its function begins."""
    monkeypatch.chdir(tmp_path)

    def begin(*words: str) -> str:
        with pytest.raises(SystemExit) as end:
            main(list(words))
        assert end.value.code == 2
        output = capsys.readouterr().err
        assert output.startswith("cognitivedrone: ")
        assert output.count("\n") == 1
        assert list(tmp_path.iterdir()) == []
        return output

    return begin


HUGE = "9" * 400


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("bench --seed -1", "--seed is -1; it must be at least 0"),
        (f"bench --seed {HUGE}", "--seed is a number of over 30 digits; it must be at most 9223372036854775807"),
        ("bench --wind 1e9", "--wind is 1000000000.0; it must be from 0 to 50 m/s"),
        ("bench --wind nan", "--wind is nan; it must be from 0 to 50 m/s"),
        ("bench --clips -1", "--clips is -1; it must be at least 0"),
        ("bench --episodes 0", "--episodes is 0; it must be at least 1"),
        ("bench --workers 100000", "--workers is 100000; it must be from 0 to 4096"),
        ("bench --decision-timeout nan", "--decision-timeout is nan; it must be at least 0.001 s"),
        ("bench --executor ray --gpus-per-worker inf", "--gpus-per-worker is inf"),
        ("reason --frames 0", "--frames is 0; it must be at least 1"),
        ("sweep --out x --ms 0 -5", "--ms is -5.0; it must be at least 0"),
        ("sweep --out x --ms inf", "--ms is inf"),
        ("verify x.json --sample 0", "--sample is 0"),
        ("verify x.json --seed -1", "--seed is -1"),
        ("fly --seed -1", "--seed is -1"),
        ("fly --ceiling inf", "--ceiling is inf; it must be a finite number"),
        ("fly --fence-radius inf", "--fence-radius is inf"),
        ("fly --episode -1", "--episode is -1"),
        ("fly --sitl-instance -1", "--sitl-instance is -1"),
        ("sim --mavlink --camera-port 65536", "--camera-port is 65536; it must be from 0 to 65535"),
        ("sim --mavlink --speed nan", "--speed is nan"),
        ("collect --out x --beta nan", "--beta is nan; it must be from 0 to 1"),
        ("collect --out x --episodes-per-shard 0", "--episodes-per-shard is 0"),
        ("data replay x -1", "--episode is -1"),
        ("train --out x --steps 0", "--steps is 0; it must be at least 1"),
        ("train --out x --processes 0", "--processes is 0; it must be from 1 to 4096"),
        ("train --out x --threads -2", "--threads is -2"),
        ("train-openvla --base x --data x --out x --micro-batch 0", "--micro-batch is 0"),
    ],
)
def test_a_number_out_of_range_is_refused(refused, line, says):
    assert says in refused(*line.split())


@pytest.mark.parametrize("line", ["bench --suite", "fly --policy", "view --out", "serve --host", "collect --out"])
def test_an_empty_text_is_refused(refused, line):
    option = line.split()[1]
    for empty in ("", " "):
        assert f"the value of {option} is empty" in refused(*line.split(), empty)
    assert f"the value of {option} is empty" in refused(line.split()[0], f"{option}=")


def test_an_empty_argument_without_an_option_is_refused(refused):
    assert "the value is empty" in refused("compare", "", "")
    assert "the value is empty" in refused("fly", "")


@pytest.mark.parametrize("name", TARGETS)
def test_every_command_checks_its_arguments_first(monkeypatch, name):
    """Whatever a command is, its wrapper has the same options and refuses the same values."""
    command = load(name)
    begun = cli._checked(command, contextlib.nullcontext)
    assert begun.__wrapped__ is command
    check_arguments(command, {})  # its annotations can be read


def test_ranges_are_found_within_annotations():
    def command(one: Count | None, many: tuple[Seed, ...], plain: float) -> None: ...

    check_arguments(command, {"one": None, "many": (0, 1), "plain": 1.5, "unknown": True})
    for wrong in ({"one": 0}, {"many": (0, -1)}, {"plain": float("nan")}, {"plain": float("-inf")}):
        with pytest.raises(Exception, match="it must be"):
            check_arguments(command, wrong)
    assert 10**400 not in Range(0, 5)
    assert 10**400 in Range(0)
    assert Annotated[int, Range(0, 2**63 - 1)] == Seed


def test_libraries_users_are_refused_too():
    with pytest.raises(UsageError, match="from 0 to 50 m/s"):
        Scenario(wind=1e9)
    with pytest.raises(TaskError, match="the name of the suite is empty"):
        open_suite("")
