"""The card is one page that loads nothing, escapes everything and shows every family."""

import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from factory import make_episode
from made_stores import write_store, writer_at

from cognitivedrone.cli import main
from cognitivedrone.data.card import HEIGHT, WIDTH, card, columns, flight_map, traces
from cognitivedrone.data.overview import Histogram
from cognitivedrone.errors import DataError
from cognitivedrone.tasks import BASE_FAMILIES


class Page(HTMLParser):
    """Open tags and the text of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def test_card_shows_every_family_and_loads_nothing(sound_store, tmp_path, flights):
    card(sound_store, tmp_path / "card.html")
    page = Page(tmp_path / "card.html")
    assert all(family.replace("_", " ") in page.text for family in BASE_FAMILIES)
    for family in BASE_FAMILIES:
        first = next(flight for flight in flights if flight.task.family == family)
        assert first.task.instruction in page.text
        assert first.task.directive in page.text
    sources = [attributes["src"] for _, attributes in page.tags if "src" in attributes]
    assert len(sources) == sum(min(6, len(flight)) for flight in flights[:10])
    assert all(source is not None and source.startswith("data:image/jpeg;base64,") for source in sources)
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.tags}
    assert not re.search(r"url\(|https?://", (tmp_path / "card.html").read_text())


def test_card_shows_what_the_camera_that_looks_down_saw(tmp_path):
    flight = make_episode(0, length=4, down=True)
    card(write_store(tmp_path / "store", [flight]), tmp_path / "card.html")
    page = Page(tmp_path / "card.html")
    told = [attributes["alt"] for tag, attributes in page.tags if tag == "img"]
    assert told == [f"frame {k} of episode 0{how}" for how in ("", ", looking down") for k in range(1, 5)]
    assert "those of a camera that looks down" in page.text


def test_the_command_says_where_the_card_is(sound_store, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["data", "report", str(sound_store)])
    assert capsys.readouterr().out == f"report: {tmp_path / 'card.html'}\n"
    assert (tmp_path / "card.html").exists()


def test_the_same_store_has_the_same_card(sound_store, tmp_path):
    shutil.copytree(sound_store, tmp_path / "copy")
    card(sound_store, tmp_path / "a.html")
    card(tmp_path / "copy", tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_text_is_escaped(tmp_path):
    flight = make_episode(0, length=2)
    hostile = replace(flight, task=replace(flight.task, instruction="Fly <script>alert(1)</script> & back"))
    card(write_store(tmp_path / "store", [hostile]), tmp_path / "card.html")
    page = Page(tmp_path / "card.html")
    assert "script" not in {tag for tag, _ in page.tags}
    assert "Fly <script>alert(1)</script> & back" in page.text


def test_what_cannot_be_shown_is_refused(tmp_path, sound_store):
    with pytest.raises(DataError, match="holds no episode"):
        card(write_empty(tmp_path / "empty"), tmp_path / "card.html")
    flight = make_episode(0, length=2)
    broken = write_store(tmp_path / "broken", [replace(flight, images=(flight.images[0], b"no image"))])
    with pytest.raises(DataError, match="the frame of episode 0, step 1, is broken"):
        card(broken, tmp_path / "card.html")
    with pytest.raises(DataError, match="its folder does not exist"):
        card(sound_store, tmp_path / "nowhere" / "card.html")
    with pytest.raises(DataError, match="is a folder"):
        card(sound_store, tmp_path)
    assert not (tmp_path / "card.html").exists()


def write_empty(path: Path) -> Path:
    writer = writer_at(path)
    writer.write_shard(0, [], {})
    writer.finish()
    return path


def test_histogram_columns_fill_the_box():
    first, last = columns(Histogram("x", "m", -1, 1, (5, 0, 0, 10)))
    assert (first.x, first.height, last.x, last.y, last.height) == (0, HEIGHT / 2, 0.75 * WIDTH, 0, HEIGHT)
    assert first.title == "-1.00 to -0.50 m: 5"


def test_traces_show_what_was_sent_only_where_it_differs():
    flight = make_episode(1, length=5)
    clean = replace(flight, sent=flight.action.copy())
    assert [trace.sent for trace in traces(clean)] == [""] * 4
    assert all(trace.sent and trace.sent != trace.label for trace in traces(flight))
    still = replace(clean, action=np.zeros_like(clean.action))
    assert traces(still)[0].label == "0.0,20.0 25.0,20.0 50.0,20.0 75.0,20.0 100.0,20.0"


def test_the_map_has_every_flight_in_the_colour_of_its_gate(flights):
    seen = flight_map(flights[:5])
    assert [color for _, color in seen.paths] == [f.task.gates[f.task.target].color for f in flights[:5]]
    x, y, width, height = map(float, seen.view_box.split())
    for (path, _), flight in zip(seen.paths, flights, strict=False):
        places = np.array([[float(n) for n in point.split(",")] for point in path.split()])
        assert len(places) == len(flight) + 1
        assert (places >= (x, y)).all()
        assert (places <= (x + width, y + height)).all()
        assert places[0, 1] > places[-1, 1]  # forward is up
