"""Batches of the stream: their layout, their truth, and that they follow from recipe and seed alone."""

import itertools
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cognitivedrone.layout import is_clear
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of, words_of
from cognitivedrone.tasks import train_task
from cognitivedrone.tasks.families.racing import INSTRUCTIONS
from cognitivedrone.training.language.questions import Question, ask
from cognitivedrone.training.launch import RECIPES
from cognitivedrone.training.perception.attributes import gate_looks
from cognitivedrone.training.small_vla import sampling, stream
from cognitivedrone.training.small_vla.sampling import LONGEST, NONE_IN_VIEW, Sampler, StreamRecipe
from cognitivedrone.training.small_vla.stream import RolloutStream
from cognitivedrone.training.trainer.training_task import Batch
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Task
from cognitivedrone.world.appearance import Appearance, photo_appearance
from cognitivedrone.world.places import names

RECIPE = RECIPES["debug"].stream
LOOKS = (*COLORS, *SHAPES, *SIZES)

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def encoder(language_checkpoint: Path) -> Path:
    return encoder_of(language_checkpoint)


def batches(
    recipe: StreamRecipe,
    count: int,
    seed: tuple[int, ...] = (1, 2),
    learner: object = None,
    encoder: Path | None = None,
) -> list[dict[str, Any]]:
    """Batches of a stream; without an encoder, sentences are in them as `text` (n, sentences)."""

    def written(sampler: Sampler, texts: list[str], frames: int) -> Batch:
        return {"text": np.array(texts, "U400").reshape(frames, sampler.recipe.sentences)}

    with pytest.MonkeyPatch.context() as patch:
        if encoder is None:
            patch.setattr(Sampler, "_encoded", written)
        rollout_stream = RolloutStream(recipe, Sampler(recipe, encoder))
        try:
            return list(itertools.islice(rollout_stream(seed, learner), count))  # type: ignore[arg-type]
        finally:
            rollout_stream.close()


class Notebook:
    """Writes down every question and task that a stream is made from: which gate is right, by sentence and scene."""

    def __init__(self) -> None:
        self.targets: dict[tuple[str, bytes], set[int]] = defaultdict(set)

    def train_task(self, index: int, seed: int) -> Task:
        task = train_task(index, seed)
        for text in (task.instruction, task.directive):
            self._write(text, task.labels, task.gates, task.target)
        return task

    def ask(self, rng: np.random.Generator, *scene: Any) -> Question:
        question = ask(rng, *scene)
        labels, _, gates, target, *_ = scene
        self._write(question.text, labels, gates, target)
        return question

    def _write(self, text: str, labels: tuple[str, ...], gates: tuple[Gate, ...], target: int) -> None:
        del labels
        self.targets[self.key(text, np.stack([gate_looks(gate) for gate in gates]))].add(target)

    @staticmethod
    def key(text: str, looks: NDArray[np.generic]) -> tuple[str, bytes]:
        return text, looks.astype(np.int64).tobytes()


@pytest.fixture(scope="module")
def notebook() -> Notebook:
    return Notebook()


@pytest.fixture(scope="module")
def made(notebook: Notebook) -> list[dict[str, Any]]:
    """Enough frames that everything occurs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "ask", notebook.ask)
        patch.setattr(stream, "train_task", notebook.train_task)
        return batches(replace(RECIPE, batch=32, sentences=4, worlds=16), 6)


def sentences(batch: Batch) -> Iterator[tuple[int, int, str]]:
    """Row, column and words of every sentence about a frame."""
    for row, column in np.ndindex(batch["asked"].shape):
        yield row, column, str(batch["text"][row, column])


def test_a_batch_has_its_layout(encoder: Path) -> None:
    b, k, width = RECIPE.batch, RECIPE.sentences, TextEncoderModel.load(encoder).size
    (batch,) = batches(replace(RECIPE, chunk=3), 1, encoder=encoder)
    expected = {
        "image": (np.uint8, (b, 256, 256, 3)),
        "state": (np.float32, (b, 5)),
        "gate": (np.float32, (b, 3, 2)),
        "in_view": (np.bool_, (b, 3)),
        "place": (np.float32, (b, 3, 3)),
        "panel": (np.float32, (b, 4, 3)),
        "legible": (np.bool_, (b, 4)),
        "action": (np.float32, (b, 3, 3, 4)),
        "valid": (np.bool_, (b, 3)),
        "ahead": (np.bool_, (b, 3)),
        "looks": (np.int64, (b, 3, 3)),
        "flown": (np.int64, (b,)),
        "words": (np.float16, (b, k, LONGEST, width)),
        "asked": (np.int64, (b, k)),
        "choice": (np.int64, (b, k)),
    }
    assert {name: (values.dtype, values.shape) for name, values in batch.items()} == expected
    assert all(np.isfinite(values).all() for values in batch.values())
    assert batch["image"].std() > 10


def test_a_share_of_the_flights_is_in_places_that_models_are_trained_in(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, ...]] = []

    def drawn(rng: np.random.Generator, among: tuple[str, ...]) -> Appearance:
        asked.append(among)
        return photo_appearance(rng, among)

    monkeypatch.setattr(stream, "photo_appearance", drawn)
    (batch,) = batches(replace(RECIPE, places=1.0, worlds=2), 1)
    assert len(asked) >= 2
    assert {*asked} == {names("training")}
    assert all(len(np.unique(image.reshape(-1, 3), axis=0)) > 2000 for image in batch["image"])
    asked.clear()
    batches(RECIPE, 1)
    assert not asked


def test_words_are_those_of_the_encoder_and_nothing_beyond(encoder: Path) -> None:
    model, seed = TextEncoderModel.load(encoder), (1, 2)
    (told,), (encoded,) = batches(RECIPE, 1, seed), batches(RECIPE, 1, seed, encoder=encoder)
    for row, column, text in sentences(told):
        words = model.words(text)[:LONGEST]
        found = encoded["words"][row, column]
        np.testing.assert_allclose(found[: len(words)], words, atol=0.02)
        assert not found[len(words) :].any()


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(encoder: Path) -> None:
    rollout_stream = RolloutStream(RECIPE, Sampler(RECIPE, encoder))
    try:
        first, other, again = (list(itertools.islice(rollout_stream((seed,)), 3)) for seed in (5, 6, 5))
    finally:
        rollout_stream.close()
    # Neither a used stream nor a new one makes a difference.
    for repeated in (again, batches(RECIPE, 3, (5,), encoder=encoder)):
        for one, two in zip(first, repeated, strict=True):
            assert {name: values.tobytes() for name, values in one.items()} == {
                name: values.tobytes() for name, values in two.items()
            }
    assert all((one["image"] != two["image"]).any() for one, two in zip(first, other, strict=True))
    assert all((one["words"] != two["words"]).any() for one, two in zip(first, other, strict=True))


def test_the_choice_is_the_gate_asked_for_where_it_is_in_view(made: list[dict[str, Any]]) -> None:
    unseen = 0
    for batch in made:
        seen = np.take_along_axis(batch["in_view"], batch["asked"], axis=1)
        np.testing.assert_array_equal(batch["choice"][seen], batch["asked"][seen])
        assert (batch["choice"][~seen] == NONE_IN_VIEW).all()
        unseen += (~seen).sum()
    assert unseen > 0


def test_only_what_is_flown_at_is_asked_for_where_it_cannot_be_seen(made: list[dict[str, Any]]) -> None:
    for batch in made:
        elsewhere = batch["asked"] != batch["flown"][:, None]
        assert np.take_along_axis(batch["in_view"], batch["asked"], axis=1)[elsewhere].all()


def test_what_is_flown_does_not_tell_what_is_asked(made: list[dict[str, Any]]) -> None:
    clear = [(batch["in_view"] & batch["legible"][:, :3]).all(axis=1) for batch in made]
    flown = np.concatenate([batch["flown"][rows] for batch, rows in zip(made, clear, strict=True)])
    asked = np.concatenate([batch["asked"][rows] for batch, rows in zip(made, clear, strict=True)])
    assert len(flown) > 40
    assert (asked == flown[:, None]).mean() < 0.75
    pairs = {(one, other) for one, row in zip(flown, asked, strict=True) for other in row}
    assert pairs == set(itertools.product(range(3), repeat=2))


# ---- sentences are true


def test_directives_describe_the_gate_that_is_asked_for(made: list[dict[str, Any]]) -> None:
    count = 0
    for batch in made:
        for row, column, text in sentences(batch):
            look = directive(text)
            if look is None:
                continue
            count += 1
            gates = [{LOOKS[index] for index in gate} for gate in batch["looks"][row]]
            fits = [look <= gate for gate in gates]
            assert fits == [gate == batch["asked"][row, column] for gate in range(3)], text
    assert count > 50


def directive(text: str) -> set[str] | None:
    """The looks that a sentence names, where it describes the gate itself."""
    found = re.fullmatch(r"[A-Za-z ]+ the ((?:(?:big|small|red|green|blue|round|square|triangle) )+)gate", text)
    return set(found[1].split()) if found else None


def test_the_gate_asked_for_is_the_right_answer(made: list[dict[str, Any]], notebook: Notebook) -> None:
    """What a question is the right answer to is checked where questions are tested; here, that nothing is mixed up."""
    count = 0
    for batch in made:
        for row, column, text in sentences(batch):
            key = notebook.key(text, batch["looks"][row])
            # The same sentence can be right for another gate that looks the same, in another flight.
            assert batch["asked"][row, column] in notebook.targets[key], text
            count += len(notebook.targets[key]) == 1
    assert count > 500


# ---- who flies


class Recorder:
    """A learner that climbs, and remembers what it was told."""

    def __init__(self) -> None:
        self.calls: list[tuple[NDArray[np.uint8], NDArray[np.float32], list[str]]] = []

    def act(self, images: NDArray[np.uint8], states: NDArray[np.float32], texts: list[str]) -> NDArray[np.float64]:
        self.calls.append((images.copy(), states.copy(), list(texts)))
        return np.tile((0.0, 0.0, 0.3, 0.0), (len(images), 1))


def test_the_learner_flies_its_share_of_worlds() -> None:
    learner = Recorder()
    calm = replace(RECIPE, learner=0.5, rolling=0.0, off_track=0.0, wind_m_s=0.0)
    batches(calm, 8, learner=learner)
    assert len(learner.calls) > 8
    for images, states, texts in learner.calls:
        assert images.shape == (2, 256, 256, 3)
        assert states.shape == (2, 5)
        assert all(texts)
    # Both go where the learner says, straight up and nowhere else, until a new flight begins.
    height = np.array([states[:, 3] for _, states, _ in learner.calls])
    speed = np.array([states[:, :2] for _, states, _ in learner.calls])
    assert np.abs(speed).max() < 0.1
    assert (height[10] > height[0] + 0.1).all()


def test_before_there_is_a_learner_the_expert_flies_all_worlds() -> None:
    learner = Recorder()
    batches(replace(RECIPE, learner=0.0), 1, learner=learner)
    assert not learner.calls
    made = batches(replace(RECIPE, learner=1.0, rolling=0.0, off_track=0.0), 12)
    assert max(batch["state"][:, 0].max() for batch in made) > 0.8


# ---- racing


def test_a_race_shows_one_gate_and_asks_for_it() -> None:
    for batch in batches(replace(RECIPE, suite="race", batch=8), 4):
        assert (batch["in_view"].sum(axis=1) <= 1).all()
        assert not batch["legible"][:, :3].any()
        np.testing.assert_array_equal(batch["asked"], np.repeat(batch["flown"][:, None], RECIPE.sentences, axis=1))
        assert {text for *_, text in sentences(batch)} <= set(INSTRUCTIONS)


def test_a_racer_in_a_crowded_room_is_to_take_the_gate_straight_ahead() -> None:
    recipe = replace(RECIPE, suite="race", crowded=1.0, batch=8)
    chosen = set()
    for batch in batches(recipe, 6):
        several = batch["in_view"].sum(axis=1) > 1
        there = batch["in_view"] & batch["valid"]
        aside = np.where(there, np.abs(batch["gate"][..., 0] - 128), np.inf)
        right = np.where(there.any(axis=1), aside.argmin(axis=1), batch["flown"])
        assert several.any()
        np.testing.assert_array_equal(batch["asked"], np.repeat(right[:, None], recipe.sentences, axis=1))
        assert {text for *_, text in sentences(batch)} <= set(INSTRUCTIONS)
        chosen |= set(right.tolist())
    assert chosen == {0, 1, 2}


def test_typed_sentences_say_what_the_training_tasks_do_not() -> None:
    known = {word for index in range(1500) for word in words_of(train_task(index, 0).instruction)}
    unknown = []
    for share in (0.0, 1.0):
        made = batches(replace(RECIPE, batch=16, typed=share), 4)
        words = [word for batch in made for *_, text in sentences(batch) for word in words_of(text)]
        unknown.append(np.mean([word not in known for word in words]))
    assert unknown[1] > 2 * unknown[0] + 0.02


def test_a_share_of_the_flights_has_gates_at_other_places() -> None:
    def flights(share: float) -> list[Any]:
        rollout_stream = RolloutStream(
            replace(RECIPE, layouts=share, worlds=6), Sampler(replace(RECIPE, layouts=share, worlds=6), None)
        )
        try:
            next(rollout_stream((4, 2)))
            return rollout_stream._flights
        finally:
            rollout_stream.close()

    assert all(flight.stage.layout is None for flight in flights(0.0))
    laid = flights(1.0)
    assert len({flight.stage.layout for flight in laid}) == 6
    for flight in laid:
        assert flight.stage.layout == flight.task.layout
        assert is_clear(flight.stage.layout, board=flight.stage.board is not None)
