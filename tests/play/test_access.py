"""Who reaches the page, and how: beside other programs, behind a proxy, through a tunnel, over ssh; what it is told."""

import contextlib
import io
import threading
import webbrowser
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import PIL.Image
import pytest
from tests.play.test_page import PAGE, Recorded, ask, live, port_of

from cognitivedrone.cli import main
from cognitivedrone.errors import TaskError
from cognitivedrone.film.frame import Scene
from cognitivedrone.play import app as play_app
from cognitivedrone.play.app import Replay
from cognitivedrone.play.board import scene_table
from cognitivedrone.play.config import PageSpec, PlayPlan
from cognitivedrone.play.server import Channels, serving_page
from cognitivedrone.play.studio import Studio
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import Gate, GatePlace, Stage

TOKEN = "a&token;of=16+/%"  # noqa: S105


def test_the_token_is_read_beside_the_cookies_of_others_and_escaped():
    with serving_page(PAGE, Channels(), Recorded(), TOKEN) as address:
        assert TOKEN not in address
        assert ask(address, "?" + urlsplit(address).query)[0] == 200
        name, escaped = f"cognitivedrone-{port_of(address)}", "a%26token%3Bof%3D16%2B%2F%25"
        for cookies in (
            f'{{"theme":"dark"}}; {name}={escaped}', f'a="b;c"; {name}={escaped}',
            f"cognitivedrone-1=no; {name}={escaped}",
        ):  # fmt: skip
            assert ask(address, "static/app.js", headers={"Cookie": cookies})[0] == 200
        assert ask(address, headers={"Cookie": f"cognitivedrone-1={escaped}"})[0] == 403


@pytest.mark.parametrize(
    ("origin", "headers", "status"),
    [
        # nginx sends its own Host upstream unless told otherwise, and the browser's Origin.
        ("https://drone.example", {"Host": "127.0.0.1:{port}", "Origin": "https://drone.example"}, 200),
        ("https://drone.example", {"Host": "drone.example", "Origin": "https://drone.example"}, 200),
        ("https://drone.example", {"Host": "127.0.0.1:{port}", "Origin": "https://evil.example"}, 403),
        ("http://localhost:9000", {"Host": "localhost:9000", "Origin": "http://localhost:9000"}, 200),
        ("http://localhost:9000", {"Host": "localhost:9000"}, 200),
        ("http://localhost:9000", {"Host": "localhost:9001"}, 403),
    ],
)
def test_behind_a_proxy_and_through_a_tunnel_the_named_address_is_let_in(origin, headers, status):
    with serving_page(PageSpec(port=0, browser=False, origin=(origin,)), Channels(), Recorded(), None) as address:
        sent = {name: value.format(port=port_of(address)) for name, value in headers.items()}
        assert ask(address, "static/app.js", headers=sent)[0] == status
        if status == 200:
            del sent["Host"]
            with live(address, additional_headers=sent):
                pass


def test_a_tunnel_without_leave_is_told_how_to_get_it_and_an_address_that_exists():
    with serving_page(PAGE, Channels(), Recorded(), None) as address:
        status, body = ask(address, headers={"Host": "localhost:9000"})
        assert status == 403
        assert f"served at 127.0.0.1:{port_of(address)}," in body.decode()
        assert "--origin http://localhost:9000" in body.decode()


def test_a_page_whose_script_is_refused_says_so():
    with serving_page(PAGE, Channels(), Recorded(), None) as address:
        page, script = ask(address)[1].decode(), ask(address, "static/app.js")[1].decode()
    assert 'id="refused"' in page
    assert '$("refused").remove()' in script


@pytest.mark.parametrize(("display", "opened"), [("", []), (":0", ["http://page"])])
def test_no_browser_of_the_console_is_opened(monkeypatch, display, opened):
    found = []
    monkeypatch.setenv("DISPLAY", display)
    for name in ("WAYLAND_DISPLAY", "WSL_DISTRO_NAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(play_app.shutil, "which", lambda _: "/usr/bin/x-www-browser")
    monkeypatch.setattr(webbrowser, "open", found.append)
    before = {*threading.enumerate()}
    play_app._announce(PlayPlan(), "http://page", lambda _: None)
    for thread in {*threading.enumerate()} - before:  # other tests leave threads that never end
        thread.join(60)
    assert found == opened


def test_a_film_that_is_a_link_is_not_shown(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("key")
    film = tmp_path / "run" / "films" / "0000" / "flight.mp4"
    film.parent.mkdir(parents=True)
    film.symlink_to(secret)
    replay = Replay.__new__(Replay)
    replay._folders, replay._episodes, replay._making = (tmp_path / "run",), [0], threading.Lock()
    with pytest.raises(TaskError, match="link"):
        replay.film(0, 0)


def test_pictures_that_come_at_the_same_time_get_names_of_their_own(tmp_path):
    image = io.BytesIO()
    PIL.Image.new("RGB", (8, 8), "red").save(image, "PNG")
    studio = Studio(PlayPlan(out=tmp_path), Channels())
    at_once = threading.Barrier(3)

    def send(slot: int) -> None:
        at_once.wait()
        studio.take_picture(slot, "image.png", image.getvalue())

    threads = [threading.Thread(target=send, args=(slot,)) for slot in range(3)]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len({picture.reference for picture in studio._pictures}) == 3
    finally:
        studio.board.close()


def test_the_printed_address_opens_the_page_also_from_a_file(monkeypatch, capsys):
    monkeypatch.setattr(play_app, "play", lambda _, ready: ready("http://127.0.0.1:8090/?token=abc"))
    with contextlib.suppress(SystemExit):
        main(["play"])
    assert "http://127.0.0.1:8090/?token=abc" in capsys.readouterr().out


GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))


@pytest.mark.parametrize(("left_out", "numbers"), [({}, [1, 2, 3]), ({"missing": 0}, [2, 3]), ({"only": 1}, [2])])
def test_gates_keep_their_numbers_where_others_are_missing(left_out, numbers):
    scene = Scene(
        Stage(GATES, ("",) * 3, **left_out), Scenery((np.zeros((8, 8, 3), np.uint8),) * 3), ("cat", "dog", "owl")
    )
    shown = scene_table(scene)["gates"]
    assert [gate["number"] for gate in shown] == numbers
    assert [gate["color"] for gate in shown] == [GATES[number - 1].color for number in numbers]


def test_the_way_of_a_gate_that_moves_is_shown():
    places = [GatePlace(4.0, 4.0 - 4.0 * index, 0.9, 0.0) for index in range(3)]
    stage = Stage(GATES, ("",) * 3, layout=(places[0], replace(places[1], sway=0.5), places[2]))
    scene = Scene(stage, Scenery((np.zeros((8, 8, 3), np.uint8),) * 3), ("cat", "dog", "owl"))
    assert [gate["way"] for gate in scene_table(scene)["gates"]] == [[], [[4.0, 1.025, 0.9], [4.0, -1.025, 0.9]], []]
