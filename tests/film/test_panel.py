import numpy as np
import pytest

from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.film.overlays import ACTIONS, PANEL_HEIGHT, WIDTH, compose
from cognitivedrone.types import ACTION_LIMITS, Guidance

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
