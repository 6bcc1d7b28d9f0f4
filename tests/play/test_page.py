"""The live page: who may open it, what it shows, what people can do there; and that it changes nothing in a flight."""

import io
import json
import time
import urllib.error
import urllib.parse
import urllib.request

import numpy as np
import pyarrow.parquet as pq
import pytest
from play_person import PAGE, Person, playing, png
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.errors import CognitiveDroneError, LabelError, ServerError
from cognitivedrone.play import server
from cognitivedrone.play.app import play
from cognitivedrone.play.board import LiveBoard, Sticks, pose_between
from cognitivedrone.play.config import PageSpec, PlayPlan
from cognitivedrone.play.flight import FlightPage, command_line
from cognitivedrone.play.lesson import keep_picture, own_scene, renamed, spoken_name
from cognitivedrone.play.server import Channels, Controls, serving_page
from cognitivedrone.terminal import console

TOKEN = "a-token-of-sixteen"  # noqa: S105


class Recorded(Controls):
    """Buttons that are only written down."""

    def __init__(self):
        self.done = []

    def do(self, command, values):
        if command == "bad":
            raise ServerError("that is not possible")
        self.done.append((command, values))


def ask(address, path="", *, data=None, headers=None):
    """Status and body of a request."""
    request = urllib.request.Request(address.partition("?")[0] + path, data, headers or {})  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:  # noqa: S310
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


@pytest.fixture
def page():
    channels, controls = Channels(), Recorded()
    with serving_page(PAGE, channels, controls, None) as address:
        yield address, channels, controls


def port_of(address):
    return urllib.parse.urlsplit(address).port


def live(address, **options):
    return connect(address.replace("http", "ws").partition("?")[0] + "live", **options)


def test_a_reader_gets_the_newest_message_of_every_channel_and_nothing_twice():
    channels = Channels()
    for number in range(5):
        channels.publish("state", {"number": number})
    channels.put("camera", b"jpeg")
    seen = {}
    assert channels.after(seen) == ['{"channel":"state","number":4}', b"jpeg"]
    assert channels.after(seen) == []
    channels.publish("state", {"number": 4})
    assert channels.after(seen) == []
    channels.put("camera", b"other")
    assert channels.after(seen) == [b"other"]


def test_the_page_needs_nothing_from_elsewhere_and_is_small(page):
    address, _, _ = page
    whole = b""
    for path in ("", "static/app.js", "static/draw.js", "static/replay.js", "static/style.css"):
        status, body = ask(address, path)
        assert status == 200
        whole += body
    assert len(whole) < 200_000
    for foreign in (b"http://", b"https://", b"@import", b"//cdn"):
        assert foreign not in whole
    for path in (
        "static/../server.py", "static/%2e%2e/server.py", "static/none.js", "etc/passwd", "static/__init__.py",
    ):  # fmt: skip
        assert ask(address, path)[0] == 404


@pytest.mark.parametrize(
    ("headers", "sentence"),
    [
        ({"Host": "evil.example:80"}, "open that address"),
        ({"Origin": "http://evil.example"}, "another page tried to use this one"),
        ({"Origin": "null"}, "another page tried to use this one"),
    ],
)
def test_pages_of_others_are_refused_with_a_sentence(page, headers, sentence):
    address, _, controls = page
    status, body = ask(address, headers=headers)
    assert (status, sentence in body.decode()) == (403, True)
    status, _ = ask(address, "picture/0", data=b"x", headers=headers)
    assert status == 403
    with pytest.raises(InvalidStatus, match=r"40[03]"), live(address, additional_headers=headers):
        pass
    assert controls.done == []


def test_with_a_token_only_who_has_it_gets_in():
    with serving_page(PAGE, Channels(), Recorded(), TOKEN) as address:
        assert address.endswith(f"/?token={TOKEN}")
        status, body = ask(address)
        assert (status, "needs its token" in body.decode()) == (403, True)
        assert ask(address, "?token=wrong-wrong-wrong")[0] == 403
        assert ask(address, f"?token={TOKEN}")[0] == 200
        cookie = f"cognitivedrone-{port_of(address)}={TOKEN}"
        assert ask(address, "static/app.js", headers={"Cookie": cookie})[0] == 200
        with pytest.raises(InvalidStatus, match="403"), live(address):
            pass
        with live(address, additional_headers={"Cookie": cookie}):
            pass


def test_another_address_than_this_machines_own_needs_a_token(monkeypatch):
    monkeypatch.delenv("COGNITIVEDRONE_SERVER_TOKEN", raising=False)
    with pytest.raises(ServerError, match="needs a token"):
        play(PlayPlan(page=PageSpec(host="0.0.0.0", port=0, browser=False)), print)  # noqa: S104


@pytest.mark.parametrize(
    "wrong", [{"suite": "open-v1:nothing"}, {"time_limit": -1.0}, {"look": "maybe"}, {"labels": "no-such-folder"}]
)
def test_what_is_misnamed_is_reported_before_a_page_opens(tmp_path, wrong):
    opened = []
    with pytest.raises(CognitiveDroneError):
        play(PlayPlan.of(page=PAGE, out=tmp_path / "out", **wrong), opened.append)
    assert opened == []


def test_a_port_that_is_taken_is_reported_with_the_way_out(page):
    port = int(page[0].rpartition(":")[2].strip("/"))
    taken = PageSpec(port=port, browser=False)
    with pytest.raises(ServerError, match="give another --port"), serving_page(taken, Channels(), Recorded(), None):
        pass


def test_nothing_that_a_browser_sends_ends_the_connection_of_another(page):
    address, channels, controls = page
    with live(address) as good, live(address) as bad:
        for rubbish in ("", "{", "[]", "1", '{"do": 3}', '{"no": 1}', '{"do": "bad"}', "[" * 9000, '{"do": {}}'):
            bad.send(rubbish)
            assert json.loads(bad.recv(timeout=60))["channel"] == "error"
        bad.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            bad.recv(timeout=60)
        channels.publish("state", {"time": 1})
        assert json.loads(good.recv(timeout=60))["time"] == 1
        good.send('{"do": "say", "text": "hello"}')
        deadline = time.monotonic() + 60
        while not controls.done and time.monotonic() < deadline:
            time.sleep(0.01)
    assert controls.done == [("say", {"text": "hello"})]


def test_only_so_many_pages_can_be_open(page, monkeypatch):
    monkeypatch.setattr(server, "VIEWERS", 1)
    address, channels, _ = page
    with live(address):
        channels.publish("state", {"time": 1})
        with pytest.raises((InvalidStatus, ConnectionClosed)), live(address) as second:
            second.recv(timeout=60)


def test_a_picture_that_is_too_large_is_refused_while_it_arrives(page):
    status, body = ask(page[0], "picture/0?name=x", data=b"\x89PNG" + b"0" * 25_000_000)
    assert (status, "20 MB" in body.decode()) == (413, True)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.svg", b"<svg xmlns='http://www.w3.org/2000/svg'><script>alert(1)</script></svg>"),
        ("a.png", b"\x89PNG" + b"\0" * 40),
    ],
)
def test_what_is_no_picture_is_refused_by_its_name_and_leaves_nothing(tmp_path, name, content):
    with pytest.raises(LabelError, match=rf"^'{name}' cannot be read as PNG, JPEG or WebP: it is .*; .*"):
        keep_picture(tmp_path, name, content, 0)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("name", "spoken"),
    [
        ("Blue-Tit_2.JPG", "blue tit 2"),
        ("<script>alert(1)</script>.png", "script alert 1 script"),
        ("../../etc/passwd", "etc passwd"),
        ("   .png", ""),
        ("собака", "собака"),
        ("x" * 300, "x" * 40),
    ],
)
def test_a_pictures_name_is_words(name, spoken):
    assert spoken_name(name) == spoken


def test_a_picture_is_named_and_asked_for_by_its_name(tmp_path):
    first = keep_picture(tmp_path, "IMG 001.png", png(), 0)
    cup = renamed(tmp_path, first, "my Cup!")
    assert (cup.name, cup.reference) == ("my cup", "mine/my_cup")
    assert (tmp_path / "mine" / "my_cup.png").is_file()
    unnamed = keep_picture(tmp_path, "???.png", png(), 1)
    assert unnamed.name == "picture 2"
    scene, target = own_scene((None, cup, unnamed), "fly to my cup please", 0)
    assert (target, scene.track[0].target, scene.track[0].labels[1:]) == (1, 1, ("mine/my_cup", "mine/picture_2"))
    assert own_scene((None, cup, None), "the one that holds tea", 0)[1] is None
    again = keep_picture(tmp_path, "my cup.jpg", png((0, 0, 9)), 2, taken=["my cup"])
    assert (again.name, again.reference) == ("my cup 2", "mine/my_cup_2")
    with pytest.raises(LabelError, match="another panel shows 'my cup' already"):
        renamed(tmp_path, again, "My Cup", taken=["my cup"])
    assert len(list((tmp_path / "mine").glob("*.png"))) == 3
    with pytest.raises(LabelError, match="is no name"):
        renamed(tmp_path, cup, " !! ")


def test_a_person_who_takes_over_wins_and_one_who_lets_go_hovers(monkeypatch):
    sticks, pilots = Sticks(), np.array([1, 0, 0, 0], np.float32)
    assert sticks.steer(pilots) is pilots
    sticks.move(np.array([0, 2, 0, 0]))
    assert sticks.steer(pilots).tolist() == [0, 2, 0, 0]
    now = time.monotonic()
    monkeypatch.setattr("cognitivedrone.play.board.time.monotonic", lambda: now + 1)
    assert sticks.steer(pilots).tolist() == [0, 0, 0, 0]
    sticks.taken = False
    assert sticks.steer(pilots) is pilots


def flown(out, page=None):
    plan = FlyPlan.of(
        instruction="Fly through the gate with the cat", policy="colour_seeker", reasoner="oracle", out=out, film=False,
        view=False,
    )  # fmt: skip
    summary = fly_mission(plan, console=console(), keyboard=io.StringIO(), pace="lockstep", page=page)
    steps = pq.read_table(out / "steps.parquet").drop_columns(["policy_s"]).to_pylist()
    return summary, steps


@pytest.mark.slow
def test_a_page_and_a_browser_that_hangs_change_nothing_in_a_flight(tmp_path):
    alone, steps = flown(tmp_path / "alone")
    channels = Channels()
    board = LiveBoard(channels)
    try:
        flight = FlightPage(FlyPlan("Fly through the gate with the cat"), board, channels)
        with serving_page(PAGE, channels, flight, None) as address, live(address) as hung, live(address, max_queue=1):
            assert json.loads(hung.recv(timeout=60))["mode"] == "flight"
            watched, again = flown(tmp_path / "watched", board)
            kinds = {"session"}
            deadline = time.monotonic() + 60
            while kinds < {"session", "scene", "state", "camera", "chase"} and time.monotonic() < deadline:
                message = hung.recv(timeout=60)
                kinds.add({99: "camera", 118: "chase"}[message[0]] if isinstance(message, bytes) else
                          json.loads(message)["channel"])  # fmt: skip
    finally:
        board.close()
    assert kinds >= {"session", "scene", "state", "camera", "chase"}
    assert (watched.ending, watched.seconds) == (alone.ending, alone.seconds)
    assert again == steps


def test_between_two_steps_the_drone_is_drawn_between_their_places():
    from types import SimpleNamespace

    def step(x, stage=0):
        status = SimpleNamespace(position=np.array([x, 0.0, 1.0]), quaternion=np.array([1.0, 0, 0, 0]), yaw=0.0)
        return SimpleNamespace(status=status, stage=stage)

    assert pose_between(step(0.0), step(1.0), 0.05)[0][0] == pytest.approx(0.5)
    assert pose_between(step(0.0), step(1.0), 9.0)[0][0] == 1.0
    assert pose_between(step(0.0), step(1.0, stage=1), 0.0)[0][0] == 1.0
    assert pose_between(None, step(1.0), 0.0)[0][0] == 1.0


def test_the_command_that_does_the_same_is_shown(tmp_path):
    assert command_line(FlyPlan("go to the cat")) == "cognitivedrone fly 'go to the cat'"
    plan = FlyPlan.of(instruction="x", suite="open-v1:test", episode=3, out=tmp_path, film=False)
    assert command_line(plan) == "cognitivedrone fly x --suite open-v1:test --episode 3"


def test_a_person_says_what_to_fly_to_and_puts_pictures_of_their_own_on_the_gates(tmp_path):
    plan = PlayPlan(page=PAGE, out=tmp_path / "play")
    with playing(plan) as address, live(address) as socket:
        person = Person(socket)
        person.until(lambda it: it.session.get("phase") == "ready")
        person.until(lambda it: len(it.scene.get("gates", ())) == 3)
        person.do("say", text="fly to the elephant")
        person.until(lambda it: it.session["phase"] == "flying")
        person.until(lambda it: len(it.state.get("seen", ())) == 3 and it.state["time"] is not None)
        person.until(lambda it: it.session["phase"] == "ready")
        assert person.session["outcome"]["headline"] == "Passed", person.session
        assert "elephant" in person.session["options"]
        assert person.session["command"] == "cognitivedrone fly 'fly to the elephant'"
        assert (tmp_path / "play" / "001" / "steps.parquet").is_file()

        person.do("say", text="fly to the glorp")
        person.until(lambda it: it.session["outcome"].get("headline") == "Not understood")

        status, body = ask(address, "picture/1?name=red%20thing.png", data=png())
        assert (status, body) == (200, b"{}")
        person.until(lambda it: it.session["mode"] == "mine" and "red thing" in it.session["options"])
        assert ask(address, "picture/1")[1][:4] == b"\x89PNG"
        person.do("say", text="the red thing, hold there")
        person.until(lambda it: it.state.get("instruction") == "the red thing, hold there")
        person.do("stick", action=[0, 0, 1, 0])
        person.until(lambda it: it.state.get("taken"))
        person.do("land")
        person.until(lambda it: it.session["phase"] == "ready")
        assert person.session["outcome"]["headline"] == "Landed by order"

        person.do("scene", mode="suite", suite="open-v1:smoke", episode=2)
        person.until(lambda it: it.session["mode"] == "suite" and it.session["episode"] == 2)
        assert person.session["target"] is None
        person.do("reveal")
        person.until(lambda it: it.session["target"] is not None)
        person.do("scene", mode="suite", suite="open-v1:nothing", episode=0)
        person.until(lambda it: "open-v1:nothing" in it.session["notice"])
        assert (person.session["suite"], person.session["episode"]) == ("open-v1:smoke", 2)
        person.do("teach")
        person.until(lambda it: "two things" in it.error.get("text", ""))
