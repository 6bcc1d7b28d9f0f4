"""Settings and fixtures that all tests share."""

import gc
import importlib
import importlib.util
import itertools
import os
import random
import signal
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from cognitivedrone.errors import MissingExtra

# Before anything imports PyTorch: the tests are the same with a graphics card as without one (`make test-card`).
CARD = os.environ.get("CARD") == "1"
if not CARD:
    os.environ["CUDA_VISIBLE_DEVICES"] = ""

# Tests load models/tiny.py and what lies in support/ by their names.
for folder in ("models", "support"):
    sys.path.insert(0, str(Path(__file__).parent / folder))

importlib.import_module("typechecked").install()

# A busy machine makes no example wrong.
settings.register_profile("no deadline", deadline=None)
settings.load_profile("no deadline")

# A shell starts background jobs with Ctrl-C ignored, and nohup starts all with hang-ups ignored; the programs that the
# tests start and signal would inherit that. A handler, which is not inherited, keeps the tests themselves going.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda number, frame: None)

OPTIONAL: tuple[str, ...] = (
    "accelerate",
    "httpx",
    "huggingface_hub",
    "matplotlib",
    "peft",
    "pymavlink",
    "rosbags",
    "safetensors",
)
OPTIONAL += ("msgpack", "serial", "starlette", "tensorboard", "tokenizers", "torch", "torchao", "transformers")
OPTIONAL += ("huggingface_hub", "uvicorn", "websockets")
ABSENT = {name for name in OPTIONAL if importlib.util.find_spec(name) is None}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--shuffle", metavar="SEED", help="modules in a random order, and the tests of each of them")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Slow tests are skipped without SLOW=1, tests of a graphics card without CARD=1. In a random order the tests of a
    module stay together, as their fixtures do; the order is that of the seed, so that all of xdist's processes have the
    same one."""
    if os.environ.get("SLOW") != "1":
        for item in items:
            if item.get_closest_marker("slow"):
                item.add_marker(pytest.mark.skip(reason="takes long: make test-slow"))
    if not CARD:
        for item in items:
            if item.get_closest_marker("card"):
                item.add_marker(pytest.mark.skip(reason="needs a graphics card: make test-card"))
    if seed := config.getoption("--shuffle"):
        modules = [list(tests) for _, tests in itertools.groupby(items, key=lambda item: item.path)]
        numbers = random.Random(seed)
        numbers.shuffle(modules)
        for tests in modules:
            numbers.shuffle(tests)
        items[:] = [item for tests in modules for item in tests]


def pytest_collection_finish() -> None:
    """What is loaded by now stays: the garbage collector need not look at all of it again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def state_homes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folders that are not there, another one each time: most tests need none, and a made one costs a millisecond."""
    folder = tmp_path_factory.mktemp("state")
    return (folder / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def state_home(state_homes: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """What the program keeps from one run to the next is none of the tests' business, nor theirs of the user's."""
    monkeypatch.setenv("XDG_STATE_HOME", str(next(state_homes)))


def absent(error: BaseException | None) -> str | None:
    """Why a test cannot run here, where the reason is a package of an extra that is not installed; else none."""
    if isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] in ABSENT:
        return f"{error.name} is not installed"
    return str(error) if isinstance(error, MissingExtra) and str(error).split()[0].partition(".")[0] in ABSENT else None


class ModuleOfTests(pytest.Module):
    """Tests whose imports need an absent extra are skipped as a whole."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        try:
            return super().collect()
        except self.CollectError as error:
            if reason := absent(error.__cause__):
                pytest.skip(reason, allow_module_level=True)
            raise


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> ModuleOfTests:
    return ModuleOfTests.from_parent(parent, path=module_path)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    yield from skipping_absent()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    yield from skipping_absent()


def skipping_absent() -> Iterator[None]:
    """Skip a test, or a fixture of one, that meets an absent extra while it runs."""
    try:
        return (yield)
    except (ModuleNotFoundError, MissingExtra) as error:
        if reason := absent(error):
            pytest.skip(reason)
        raise


@pytest.fixture(scope="session", autouse=True)
def nothing_waits_for_the_disk() -> Iterator[None]:
    """What the tests write need not survive a power failure."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def packaged_weights_open_once() -> Iterator[None]:
    """Sessions of the packaged networks are kept: a session has no state, and its optimisation takes a second."""
    from cognitivedrone.models import onnx_file

    weights, made, open_session = Path(onnx_file.__file__).parent / "weights", {}, onnx_file._open_session

    def opened(content: bytes, path: Path, **options: Any) -> Any:
        if not Path(path).is_relative_to(weights):
            return open_session(content, path, **options)
        key = (content, *sorted(options.items()))
        if key not in made:
            made[key] = open_session(content, path, **options)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onnx_file, "_open_session", opened)
        yield


@pytest.fixture(scope="session")
def tiny_model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole model file of a network that answers what tests can foresee. For reading only."""
    from tiny import tiny_model

    return tiny_model(tmp_path_factory.mktemp("models") / "tiny.onnx")


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of the whole smoke suite, all of it passed. For reading only."""
    from made_once import made_once

    from cognitivedrone.benchmark import Plan, run

    def make(folder: Path) -> None:
        plan = Plan.of(policy="oracle", suite="open-v1:smoke", workers=0, clips=0, out=folder / "smoke")
        run(plan, progress=False)

    return made_once(tmp_path_factory, "run", make) / "smoke"


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """PyTorch on one thread: faster for tiny networks, by far where the machine is busy; and sums have one order."""
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def no_vlm_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing in the environment says which chat API to ask, or with which key."""
    for name in ("COGNITIVEDRONE_VLM_URL", "COGNITIVEDRONE_VLM_MODEL", "COGNITIVEDRONE_VLM_KEY"):
        monkeypatch.delenv(name, raising=False)
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
