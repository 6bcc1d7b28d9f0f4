"""Gazebo as a program of ours, played by a script."""

from __future__ import annotations

import os

import pytest
from studio import gone, installed, started

from cognitivedrone.errors import GazeboError
from cognitivedrone.vehicles.gazebo.server import GazeboServer, own_partition


def refuse() -> None:
    raise GazeboError("no Gazebo answers")


def test_it_runs_without_a_window_in_its_own_partition_and_ends_with_its_children(tmp_path):
    world = tmp_path / "w" / "world.sdf"
    world.parent.mkdir()
    world.touch()

    def answer() -> list[str]:
        if not started(tmp_path):
            raise GazeboError("no Gazebo answers")
        return started(tmp_path)

    with (
        installed(tmp_path, "sleep 1000 & sleep 1000"),
        own_partition() as partition,
        GazeboServer(world, tmp_path / "gazebo.log") as server,
    ):
        pid, found, *arguments = server.connect(answer)
        assert found == partition
        assert arguments == ["sim", "-s", "-r", "--headless-rendering", "-v", "3", str(world)]
    assert gone(int(pid))


def test_a_partition_lasts_as_long_as_its_block(monkeypatch):
    monkeypatch.delenv("GZ_PARTITION", raising=False)
    monkeypatch.setenv("GZ_IP", "10.0.0.7")
    with own_partition() as first:
        assert (os.environ["GZ_PARTITION"], os.environ["GZ_IP"]) == (first, "10.0.0.7")
        with own_partition() as second:
            assert second != first
        assert os.environ["GZ_PARTITION"] == first
    assert "GZ_PARTITION" not in os.environ
    monkeypatch.delenv("GZ_IP")
    with own_partition():
        assert os.environ["GZ_IP"] == "127.0.0.1"
    assert "GZ_IP" not in os.environ


def test_what_ends_at_once_is_reported_with_its_last_words(tmp_path):
    with (
        installed(tmp_path, "echo no display >&2; exit 3"),
        GazeboServer(tmp_path / "world.sdf", tmp_path / "gazebo.log") as server,
        pytest.raises(GazeboError, match="gz sim ended with 3, its last line of output: no display"),
    ):
        server.connect(refuse)


def test_without_gazebo_it_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(GazeboError, match=r"no command `gz` .* apt-get install gz-harmonic"):
        GazeboServer(tmp_path / "world.sdf", tmp_path / "gazebo.log")


def test_warnings_and_errors_of_every_release_are_found(tmp_path):
    lines = [
        r"\033[1;31m[Err] [SystemLoader.cc:92] Failed\033[0m",
        "[Msg] Loading world",
        "[Wrn] [Component.hh:144] odd",
        "(2026-01-01 10:00:00.000) [error] [Server.cc:12] jetty",
        "Warning [Utils.cc:132] unknown element",
        "Error Code 1: Msg: broken",
        "Errors are not expected",
    ]
    then = "; ".join(f"printf '{line}\\n'" for line in lines)
    with installed(tmp_path, then), GazeboServer(tmp_path / "w.sdf", tmp_path / "gazebo.log") as server:
        with pytest.raises(GazeboError):
            server.connect(refuse)
        reported = server.complaints()
    assert len(reported) == 5
    assert reported[0] == "[Err] [SystemLoader.cc:92] Failed"
