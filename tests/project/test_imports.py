"""What importing the package loads, and what it must not."""

import json
import subprocess
import sys
import warnings

import pytest

from cognitivedrone import benchmark
from cognitivedrone.cli import TARGETS, main


def modules_after(statement: str) -> set[str]:
    code = f"{statement}\nimport sys; print('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_importing_the_package_loads_next_to_nothing():
    loaded = modules_after("import cognitivedrone")
    assert not loaded & {"torch", "mujoco", "gymnasium", "numpy", "PIL"}


def test_no_room_of_the_base_loads_a_learning_framework():
    rooms = ("tasks", "labels", "envs.gym", "envs.vector", "benchmark.runs.runner", "cli")
    loaded = modules_after("; ".join(f"import cognitivedrone.{room}" for room in rooms))
    assert not loaded & {"torch", "transformers", "tensorflow", "jax"}


HEAVY = {
    "jaxtyping", "mujoco", "scipy", "gymnasium", "av", "PIL", "pyarrow", "onnxruntime", "torch", "rich",
    "numpy", "jinja2",
}  # fmt: skip


LOADED = """
import json, os, sys
from cognitivedrone.cli import main
for arguments in json.loads(sys.argv[1]):
    if not (child := os.fork()):  # starting Python for each would take longer
        try:
            main(arguments)
        except SystemExit:
            pass
        print("loaded:", json.dumps([arguments, [*sys.modules]]), flush=True)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0, arguments
"""


COMMANDS = [("--version",), *((*words, "--help") for words in ((), ("data",), *(name.split() for name in TARGETS)))]


@pytest.fixture(scope="module")
def loaded() -> dict[tuple[str, ...], set[str]]:
    """The modules that each of the commands has loaded at its end."""
    program = [sys.executable, "-c", LOADED, json.dumps(COMMANDS)]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    lines = [line.removeprefix("loaded: ") for line in done.stdout.splitlines() if line.startswith("loaded: ")]
    return {tuple(arguments): set(modules) for arguments, modules in map(json.loads, lines)}


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_loads_nothing_heavy(loaded, command):
    assert "cognitivedrone.cli" in loaded[command]
    assert not loaded[command] & HEAVY


def test_a_command_loads_none_of_the_others(loaded):
    assert "cognitivedrone.cli.scoring" in loaded["bench", "--help"]
    assert not loaded["bench", "--help"] & {
        "cognitivedrone.cli.data",
        "cognitivedrone.cli.flying",
        "cognitivedrone.cli.training",
    }


def test_what_the_benchmark_names_is_there_when_it_is_asked_for():
    loaded = modules_after("import cognitivedrone.benchmark")
    assert "cognitivedrone.benchmark.runs.runner" not in loaded
    assert all(getattr(benchmark, name) is not None for name in benchmark.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        benchmark.nothing  # noqa: B018


STATE = """
import ast, decimal, faulthandler, gc, importlib, locale, logging, multiprocessing, os, pathlib, pkgutil, random
import signal, socket, sys, threading, warnings
import numpy
import PIL.Image
import cognitivedrone


def state():
    torch = sys.modules.get("torch")
    root = logging.getLogger()
    return {
        "environment": dict(os.environ),
        "warnings": (list(warnings.filters), warnings.formatwarning, warnings.showwarning),
        "signals": {number: signal.getsignal(number) for number in signal.valid_signals()},
        "hooks": (sys.excepthook, sys.unraisablehook, sys.displayhook, threading.excepthook),
        "streams": (sys.stdin, sys.stdout, sys.stderr),
        "path": (list(sys.path), list(sys.meta_path), os.getcwd()),
        "threads": (threading.active_count(), threading.stack_size(), threading.gettrace(), threading.getprofile()),
        "processes": (multiprocessing.get_start_method(allow_none=True), multiprocessing.active_children()),
        "logging": (root.level, list(root.handlers), list(root.filters), logging.getLogRecordFactory()),
        "interpreter": (sys.getrecursionlimit(), sys.getswitchinterval(), gc.get_threshold()),
        "crashes": faulthandler.is_enabled(),
        "random": (random.getstate(), repr(numpy.random.get_state())),
        "numbers": (numpy.geterr(), numpy.get_printoptions(), repr(decimal.getcontext())),
        "language": locale.setlocale(locale.LC_ALL),
        "pictures": PIL.Image.MAX_IMAGE_PIXELS,
        "sockets": socket.getdefaulttimeout(),
        "torch": torch and (torch.get_num_threads(), torch.get_default_dtype(), torch.is_grad_enabled()),
    }


def import_all(names):
    for name in sorted(names):
        try:
            importlib.import_module(name)
        except Exception:  # an extra that is not installed, or no module but what a module holds
            pass


def imported_by(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import) and not node.col_offset:
            yield from (name.name for name in node.names)
        if isinstance(node, ast.ImportFrom) and not node.col_offset:
            yield from (node.module, *(node.module + "." + name.name for name in node.names))


folder = pathlib.Path(cognitivedrone.__file__).parent
ours = [module.name for module in pkgutil.walk_packages([str(folder)], "cognitivedrone.")]
others = {name for path in folder.rglob("*.py") for name in imported_by(path)}
import_all(name for name in others if not name.startswith("cognitivedrone"))
before = state()
import_all(name for name in ours if not name.endswith("__main__"))
after = state()
imported = [name for name in sys.modules if name.startswith("cognitivedrone.")]
print(len(imported), *(name for name in before if before[name] != after[name]))
"""


def test_no_module_changes_the_state_of_the_process_as_it_is_imported():
    done = subprocess.run([sys.executable, "-c", STATE], capture_output=True, text=True, check=True)
    count, *changed = done.stdout.split()
    assert int(count) > 150
    assert changed == []


def test_a_command_leaves_the_format_of_warnings_as_it_was(capsys):
    before = warnings.formatwarning
    main(["--version"])
    assert warnings.formatwarning is before
