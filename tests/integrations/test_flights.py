"""Episodes flown step by step are those of the benchmark, whatever harness flies them."""

import numpy as np
import pytest

from cognitivedrone import evaluate
from cognitivedrone.data.formats.lerobot_files import IMAGE_KEY, feature_spec
from cognitivedrone.errors import AirframeError, SimulationError, TaskError
from cognitivedrone.integrations.flights import CAMERA, OUTCOMES, STATE, HarnessFlights, family_of, metrics_of
from cognitivedrone.plan import Scenario
from cognitivedrone.policies.expert import Expert
from cognitivedrone.policies.small import state_of
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import EpisodeContext


class Weaver:
    """Flies by what it sees: any difference in the frames or in the state, which is float32, changes the path."""

    def reset(self, context):
        pass

    def act(self, observation):
        return self.command(observation.image, state_of(observation))[None]

    def command(self, image, state):
        bright = np.float32(image.mean() / 255)
        return np.array([1.5, state[1] + 0.3 * bright, 0.2 * (1.0 - state[3]), state[4]], np.float32)


def flown(flights, episode, seed, policy):
    view, done = flights.begin(episode, seed), False
    while not done:
        view, _, done = flights.step(policy.command(view.image, view.state))
    return flights.results()


@pytest.fixture(scope="module")
def smoke():
    made = HarnessFlights(Scenario.of(suite="open-v1:smoke"))
    yield made
    made.close()


@pytest.mark.parametrize("seed", [0, 5])
def test_an_episode_is_the_one_that_the_benchmark_flies(smoke, tmp_path, seed):
    scored = evaluate(Weaver(), suite="open-v1:smoke", seed=seed, episodes=1, out=tmp_path / "run", progress=False)
    for episode in scored.results.episodes:
        assert flown(smoke, episode.episode, seed, Weaver()) == episode.stages


@pytest.mark.parametrize("suite", ["open-v3:swaying", "open-v3:gates"])
def test_gates_that_move_and_stages_with_two_of_them_are_those_of_the_benchmark(suite):
    episodes = evaluate(Weaver(), suite=suite, episodes=2, progress=False).results.episodes
    flights = HarnessFlights(Scenario.of(suite=suite))
    assert [flown(flights, each.episode, 0, Weaver()) for each in episodes] == [each.stages for each in episodes]
    flights.close()


def test_another_seed_starts_elsewhere_and_the_same_one_does_not(smoke):
    first, other, again = (smoke.begin(3, seed) for seed in (0, 1, 0))
    assert first.state[3] != other.state[3]
    assert np.array_equal(first.state, again.state)
    assert np.array_equal(first.image, again.image)


@pytest.mark.parametrize("action", [[1.0, 0.0, 0.0], [1.0, 0.0, np.nan, 0.0], np.zeros((2, 4)), "forward", None])
def test_an_action_that_is_none_ends_the_episode_as_policy_error(smoke, action):
    smoke.begin(0, 0)
    smoke.step([1.0, 0.0, 0.0, 0.0])
    _, reward, done = smoke.step(action)
    assert (reward, done) == (0.0, True)
    assert [result.outcome for result in smoke.results()] == ["policy_error"]


def test_an_episode_that_is_left_counts_as_timed_out(smoke):
    smoke.begin(0, 0)
    smoke.step(np.zeros(4))
    assert smoke.results()[0].outcome == "timeout"


def test_declining_passes_where_nothing_that_is_asked_for_is_there():
    absent = HarnessFlights(Scenario.of(suite="open-v2:absent"))
    view, done, steps = absent.begin(0, 0), False, 0
    while not done:
        view, reward, done = absent.step(np.zeros(4), declines=True)
        steps += 1
    metrics = metrics_of(absent.results())
    absent.close()
    assert (reward, steps, view.stage) == (1.0, 30, 0)
    assert (metrics["success"], metrics["choice"]) == (True, 1.0)


def test_a_track_leads_through_its_stages():
    tracks = HarnessFlights(Scenario.of(suite="open-v1:track"))
    view, expert, stages, rewards, done = tracks.begin(0, 0), Expert(), [], 0.0, False
    while not done:
        if view.stage not in stages:
            stages.append(view.stage)
            expert.reset(EpisodeContext(view.instruction, 0, view.stage, tracks._worlds.runners[0].truth()))
        view, reward, done = tracks.step(expert.act(None)[0])
        rewards += reward
    metrics = metrics_of(tracks.results())
    tracks.close()
    assert stages == [0, 1, 2, 3, 4]
    assert rewards == 5 * metrics["score"] == metrics["passed"]
    assert tracks.max_steps == 5 * 300
    assert family_of(tracks.suite.tracks[0]) == "track"


class Listening(Expert):
    """The expert, which notes what it is told."""

    def __init__(self):
        super().__init__()
        self.told = []

    def act(self, observation):
        self.told.append(observation.instruction)
        return super().act(observation)


def test_a_mission_is_told_and_flown_as_the_benchmark_does():
    scored, mission = Listening(), load_suite("open-v3:missions").tracks[0][0].mission
    (episode,) = evaluate(scored, suite="open-v3:missions", episodes=1, progress=False).results.episodes
    flights, told, stage, done = HarnessFlights(Scenario.of(suite="open-v3:missions")), [], -1, False
    view, expert = flights.begin(0, 0), Expert()
    while not done:
        if view.stage != stage:
            stage = view.stage
            expert.reset(EpisodeContext(view.instruction, 0, stage, flights._worlds.runners[0].truth()))
        told.append(view.instruction)
        view, _, done = flights.step(expert.command())
    results = flights.results()
    flights.close()
    assert results == episode.stages
    assert [result.outcome for result in results] == ["passed", "passed"]
    assert told == scored.told
    assert set(told) == {mission}


def test_metrics_are_plain_and_count_every_outcome(smoke):
    smoke.begin(0, 0)
    smoke.step("nonsense")
    metrics = metrics_of(smoke.results())
    assert (metrics["success"], metrics["score"], metrics["choice"]) == (False, 0.0, 0.0)
    assert {name: metrics[name] for name in OUTCOMES} == dict.fromkeys(OUTCOMES, 0) | {"policy_error": 1}
    assert metrics["stages"][0]["outcome"] == "policy_error"


def test_episodes_are_chosen_by_family(smoke):
    letters = smoke.episodes("letters")
    assert letters
    assert {smoke.suite.tracks[episode][0].family for episode in letters} == {"letters"}
    assert len(smoke.episodes()) == 30
    with pytest.raises(TaskError, match="no family 'leters'; did you mean 'letters'"):
        smoke.episodes("leters")


def test_what_cannot_be_flown_is_reported_before_anything_is_rendered():
    with pytest.raises(AirframeError):
        HarnessFlights(Scenario.of(suite="open-v1:smoke", airframe="dji"))
    with pytest.raises(SimulationError, match="time_limit_s"):
        HarnessFlights(Scenario.of(suite="open-v1:smoke"), time_limit_s=0)
    with pytest.raises(TaskError, match="call begin first"):
        HarnessFlights(Scenario.of(suite="open-v1:smoke")).step(np.zeros(4))


def test_camera_and_state_are_those_of_the_export():
    assert f"observation.images.{CAMERA}" == IMAGE_KEY
    assert list(STATE) == feature_spec(video=False)["observation.state"]["names"]
