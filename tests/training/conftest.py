"""What several tests of training start from."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from made_once import made_once


@pytest.fixture(scope="module")
def made_small() -> Iterator[None]:
    """Few pictures and frames where a real training draws thousands."""
    with small():
        yield


@contextmanager
def small() -> Iterator[None]:
    import torch
    from quick_trainings import make_small

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as `one_thread`, also for what is made once for all modules
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        yield
    torch.set_num_threads(threads)


@pytest.fixture
def no_accelerator() -> Iterator[None]:
    """Accelerate's settings hold for the whole process: those of earlier tests are none of these tests' business."""
    from accelerate.state import AcceleratorState

    AcceleratorState._reset_state(reset_partial_state=True)
    yield
    AcceleratorState._reset_state(reset_partial_state=True)


@pytest.fixture(scope="session")
def reader_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny reader with random weights."""
    from quick_trainings import TINY_READER, saved

    from cognitivedrone.training.trainer.checkpoint import CHECKPOINT
    from cognitivedrone.training.trainer.training_task import Given

    def make(folder: Path) -> None:
        with small():
            saved(TINY_READER.training(Given()), folder)

    return made_once(tmp_path_factory, "reader", make) / CHECKPOINT


@pytest.fixture(scope="session")
def selector_checkpoint(tmp_path_factory: pytest.TempPathFactory, reader_checkpoint: Path) -> Path:
    """A tiny gate selector with random weights, which listens to that reader."""
    from quick_trainings import saved

    from cognitivedrone.training.reasoner.selector import DEBUG_SELECTOR
    from cognitivedrone.training.trainer.checkpoint import CHECKPOINT
    from cognitivedrone.training.trainer.training_task import Given

    def make(folder: Path) -> None:
        with small():
            saved(DEBUG_SELECTOR.training(Given(start=reader_checkpoint)), folder)

    return made_once(tmp_path_factory, "selector", make) / CHECKPOINT


@pytest.fixture(scope="session")
def language_checkpoint(tmp_path_factory: pytest.TempPathFactory, selector_checkpoint: Path) -> Path:
    """A tiny language with random weights and that reader, beside its text encoder."""
    from quick_trainings import saved

    from cognitivedrone.training.small_vla.language import DEBUG_LANGUAGE
    from cognitivedrone.training.trainer.checkpoint import CHECKPOINT
    from cognitivedrone.training.trainer.training_task import Given

    def make(folder: Path) -> None:
        with small():
            task = DEBUG_LANGUAGE.training(Given(start=selector_checkpoint))
            task.export(saved(task, folder), folder)

    return made_once(tmp_path_factory, "language", make) / CHECKPOINT


@pytest.fixture(scope="session")
def policy_checkpoint(tmp_path_factory: pytest.TempPathFactory, language_checkpoint: Path) -> Path:
    """A tiny policy with random weights and that language, beside its text encoder."""
    from quick_trainings import saved

    from cognitivedrone.models.words.text_encoder import FILE
    from cognitivedrone.models.words.word_pieces import PIECES_FILE
    from cognitivedrone.training.launch import RECIPES
    from cognitivedrone.training.trainer.checkpoint import CHECKPOINT
    from cognitivedrone.training.trainer.training_task import Given

    def make(folder: Path) -> None:
        for name in (FILE, PIECES_FILE):
            shutil.copy(language_checkpoint.parent / name, folder)
        with small():
            saved(RECIPES["debug"].training(Given(start=language_checkpoint)), folder)

    return made_once(tmp_path_factory, "policy", make) / CHECKPOINT


@pytest.fixture(scope="session")
def policy_file(tmp_path_factory: pytest.TempPathFactory, policy_checkpoint: Path) -> Path:
    """That policy as a model file, beside its text encoder, panel reader and language."""
    from cognitivedrone.models.words.text_encoder import FILE
    from cognitivedrone.training.small_vla.export import export

    def make(folder: Path) -> None:
        encoder = policy_checkpoint.parent / FILE
        with small():
            export(policy_checkpoint, folder / "model.onnx", encoder=encoder)

    return made_once(tmp_path_factory, "file", make) / "model.onnx"


@pytest.fixture(scope="session")
def reasoner_parts(tmp_path_factory: pytest.TempPathFactory, policy_file: Path) -> Path:
    """The folder of a barely trained gate selector, as one command writes it, with the other parts of that policy."""
    from quick_trainings import SMALL_SELECTOR, InProcess

    from cognitivedrone.training.config import TrainPlan
    from cognitivedrone.training.launch import ALL_RECIPES, run
    from cognitivedrone.training.trainer import trainer

    def make(folder: Path) -> None:
        out = folder / "selector"
        with small(), pytest.MonkeyPatch.context() as patch:
            patch.setattr(trainer, "PrefetchQueue", InProcess)
            patch.setitem(ALL_RECIPES, "selector", SMALL_SELECTOR)
            assert run(TrainPlan(out, "selector", start=policy_file)) == out / "gate_selector.onnx"
        assert {path.name for path in out.glob("*.onnx")} == {"gate_selector.onnx", "word_pieces.onnx"}
        for name in ("eyes.onnx", "language.onnx", "text_encoder.onnx"):
            shutil.copy(policy_file.parent / name, out)

    return made_once(tmp_path_factory, "reasoner", make) / "selector"


@pytest.fixture(scope="session")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set, large enough for two families to have a flight in both splits. For reading only."""
    from collect_pools import flying, forwards

    from cognitivedrone.collect import collector

    def make(folder: Path) -> None:
        plan = collector.CollectPlan.of(out=folder / "set", recipe="debug", episodes=24, episodes_per_shard=8)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(collector, "pool_of", flying(forwards))
            collector.collect(plan, progress=False)

    return made_once(tmp_path_factory, "flights", make) / "set"
