"""Films of flights, written and read back: what they show, how long, and their page; and the panel above a clip."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.cli import main
from cognitivedrone.errors import PluginError
from cognitivedrone.film.frame import Film, FilmFrame, Scene, Verdict, reading_of
from cognitivedrone.film.movie import END_S, FPS, LONGEST_S, pictures, read_mp4, write_flight
from cognitivedrone.film.overlays import ACTIONS, PANEL_HEIGHT, READING, WIDTH, compose
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.reasoners.scene_text import UNREADABLE
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import ACTION_LIMITS, Event, Gate, Guidance, SeenPanel, Stage

GATES = (Gate("big", "round", "red"), Gate("small", "square", "blue"), Gate("big", "triangle", "green"))
SCENE = Scene(Stage(GATES, ("",) * 3), Scenery((np.full((8, 8, 3), 200, np.uint8),) * 3), ("cat", "dog", "<b>owl"))
VERDICT = Verdict("good", "Passed: through gate 1", ("2.0 s flown",))
CARD = round(END_S * FPS)


def flight(steps: int, *, times: tuple[float, ...] = (), known: bool = True) -> list[FilmFrame]:
    guidance = Guidance("Fly through the big red round gate", 0, 0.9)
    image = np.full((256, 256, 3), (10, 120, 30), np.uint8)
    return [
        FilmFrame(
            image, guidance.directive, guidance, np.array([1.0, 0, 0, 0.5]), times[i] if times else i / 10, 0,
            "Find the <cat>", np.array([0.2 * i, 0.0, 1.0]) if known else None,
            quaternion_from_yaw(0.1 * i) if known else None,
        )
        for i in range(steps)
    ]  # fmt: skip


def test_a_film_read_back_shows_the_views_and_ends_with_the_outcome(tmp_path: Path) -> None:
    events = [Event(0.1, "adopted", "Fly <through>")]
    page = write_flight(tmp_path / "new", Film("small on sim", flight(4), [SCENE], VERDICT, events))
    shown = list(read_mp4(page.with_name("flight.mp4")))
    assert len(shown) == 4 * 2 + CARD
    first = shown[0].astype(int)
    assert first.shape == (720, 1280, 3)
    assert np.allclose(first[400:700, 20:500].mean(axis=(0, 1)), (10, 120, 30), atol=6)  # the drone's view
    chase = first[80:512, 512:]
    assert (chase[..., 2] - chase[..., 0])[:100].max() > 60  # sky
    assert (chase[..., 0] - chase[..., 1]).max() > 100  # the red gate
    assert abs(shown[0].astype(int) - shown[1])[80:512, 512:].mean() > 0.3  # between two control steps it moves on
    assert abs(shown[2].astype(int) - shown[1])[512:, 1018:].max() < 60
    card = shown[-1].astype(int)
    assert card[300:460].max() > 150
    assert ((card[..., 1] - card[..., 0] > 100) & (card[..., 1] > 150)).sum() > 500  # the outcome, green
    text = page.read_text()
    assert "Passed: through gate 1" in text
    assert "Fly &lt;through&gt;" in text
    assert 'src="flight.mp4"' in text
    assert not list(page.parent.glob("*.part"))


def test_nothing_is_filmed_through_a_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = tmp_path / "theirs"
    theirs.write_text("precious")
    out = tmp_path / "out"
    out.mkdir()
    for name in ("flight.mp4", "flight.mp4.part", "flight.html", "flight.html.tmp"):
        (out / name).symlink_to(theirs)

    def write(film: Film, path: Path, airframe: object) -> int:
        with path.open("ab") as file:  # as FFmpeg does, through a link if there is one
            return file.write(b"film" * len(list(film.frames)))

    monkeypatch.setattr("cognitivedrone.film.movie.write_film", write)
    assert write_flight(out, Film("", flight(3), [], VERDICT)) == out / "flight.html"
    assert theirs.read_text() == "precious"
    assert (out / "flight.mp4").read_bytes() == b"film" * 3


def test_what_is_read_of_the_panels_is_in_film_and_page(tmp_path: Path) -> None:
    box = (100.0, 60.0, 40.0)
    dog = SeenPanel("blue", box, "dog or maybe wolf", (("dog", 0.75), ("<wolf>", 0.2), ("cat", 0.001)), 0.9)
    people = SeenPanel("green", box, "a person (bald)", (("cat", 0.1),))
    assert reading_of(dog) == ("dog", dog.readings)
    assert reading_of(people) == ("a person (bald)", ())
    assert reading_of(replace(people, shown=UNREADABLE, readings=(("", 0.4),))) == ("nothing known", ())
    assert reading_of(replace(people, shown=UNREADABLE)) == ("cat", people.readings)
    frames = flight(3)
    frames = [frames[0], *(replace(frame, seen=(dog, people), stage=1) for frame in frames[1:])]
    first, *_, last = pictures(Film("", frames, [SCENE], VERDICT))
    strip = np.s_[512:, 762:1018]  # the list of gates, also when the track is over, and on the end card
    shown = [((picture[strip] == READING).all(axis=2)).any() for picture in (first, last)]
    assert shown == [False, True]
    map_of = np.s_[512:, 512:762]
    assert (last[map_of] == (250, 204, 21)).all(axis=2).any()  # the path
    page = write_flight(tmp_path, Film("", frames, [SCENE], VERDICT)).read_text()
    assert "<td>gate 2, blue</td><td>dog</td><td>dog (75%), &lt;wolf&gt; (20%)</td>" in page
    assert "<td>gate 3, green</td><td>&lt;b&gt;owl</td><td>a person (bald)</td>" in page


def test_a_film_keeps_the_time_of_late_steps_and_shortens_long_pauses() -> None:
    shown = list(pictures(Film("", flight(4, times=(0.0, 0.3, 0.4, 60.0)), [], VERDICT)))
    assert len(shown) == 6 + 2 + LONGEST_S * FPS + 2 + CARD


def test_a_flight_in_an_unknown_world_and_one_without_a_step_are_shown_as_far_as_they_go(tmp_path: Path) -> None:
    assert len(list(pictures(Film("", flight(2, known=False), [], VERDICT)))) == 4 + CARD
    page = write_flight(tmp_path, Film("", [], [], VERDICT))
    assert "There is no film" in page.read_text()
    assert not page.with_name("flight.mp4").exists()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes, flown."""
    out = tmp_path_factory.mktemp("flown") / "run"
    words = ["--suite", "open-v1:smoke", "--policy", "oracle", "--episodes", "2", "--clips", "0", "--workers", "0"]
    main(["bench", *words, "--out", str(out)])
    return out


def test_an_episode_of_a_run_is_filmed_as_it_was_flown(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["film", str(run), "--episode", "1"])
    assert "Passed: through gate" in capsys.readouterr().out
    steps = json.loads((run / "results.json").read_text())["episodes"][1]["steps"]
    assert len(list(read_mp4(run / "films" / "0001" / "flight.mp4"))) == 2 * steps + CARD
    for words, output in (
        (["--episode", "2"], "has no episode 2; it has 0 to 1"),
        (["--tasks", "nowhere.json"], "nowhere.json"),
    ):
        with pytest.raises(SystemExit):
            main(["film", str(run), *words])
        assert output in capsys.readouterr().err
    (run / "films").rename(tmp_path / "elsewhere")
    (run / "films").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(SystemExit):
        main(["film", str(run)])
    assert "'films' is a link or in one" in capsys.readouterr().err


def test_a_run_never_names_code_that_filming_it_would_import(run: Path, tmp_path: Path) -> None:
    from cognitivedrone.benchmark.runs.film import film_episode

    (tmp_path / "run").mkdir()
    results = (run / "results.json").read_text().replace('"policy": "oracle"', '"policy": "os:system"')
    (tmp_path / "run" / "results.json").write_text(results)
    with pytest.raises(PluginError, match="os:system"):
        film_episode(tmp_path / "run")


BLUE, ORANGE, GREEN = (96, 165, 250), (251, 146, 60), (52, 211, 153)


def frame(action=(0.0, 0.0, 0.0, 0.0), confidence=None, text="Fly through the small red round gate", time=1.2):
    guidance = None if confidence is None else Guidance(text, 0, confidence)
    image = np.zeros((256, 256, 3), np.uint8)
    image[:128] = (250, 10, 10)
    return FilmFrame(image, text, guidance, np.array(action, np.float32), time, 0)


def width_of(picture, color):
    """Columns of the panel in which a colour occurs."""
    return int((picture[:PANEL_HEIGHT] == color).all(axis=2).any(axis=0).sum())


def test_the_view_is_under_the_panel_as_the_drone_saw_it():
    picture = compose(frame(), 1)
    assert picture.shape == (WIDTH + PANEL_HEIGHT, WIDTH, 3)
    assert (picture[PANEL_HEIGHT + 100, WIDTH - 20] == (250, 10, 10)).all()
    assert (picture[-20, WIDTH // 2] == 0).all()


@pytest.mark.parametrize("component", range(4))
@pytest.mark.parametrize("share", [-1.0, -0.5, 0.25, 1.0])
def test_a_bar_is_as_long_as_its_action(component, share):
    action = np.zeros(4)
    action[component] = share * ACTION_LIMITS[component]
    picture = compose(frame(action), 1)
    half = ACTIONS[component][2] / 2
    assert width_of(picture, BLUE if share > 0 else ORANGE) == pytest.approx(abs(share) * half, abs=3)


def test_what_lies_beyond_the_limits_ends_at_the_groove():
    assert width_of(compose(frame((30.0, 0, 0, 0)), 1), BLUE) <= ACTIONS[0][2] / 2 + 1


@pytest.mark.parametrize("confidence", [0.25, 1.0])
def test_the_reasoners_confidence_is_a_bar(confidence):
    assert width_of(compose(frame(confidence=confidence), 1), GREEN) == pytest.approx(110 * confidence, abs=3)
    assert width_of(compose(frame(), 1), GREEN) == 0


def test_directive_and_time_and_stage_are_drawn():
    plain = compose(frame(), 1)
    for other in (compose(frame(text="Fly on"), 1), compose(frame(time=9.9), 1), compose(frame(), 5)):
        assert (plain != other).any()
    assert (plain == compose(frame(), 1)).all()
