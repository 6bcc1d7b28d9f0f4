"""What the set-up does to a machine: system packages are asked for or announced, PyTorch may be left out."""

import importlib.util
import io
import json
import subprocess
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

FILE = Path(__file__).resolve().parents[2] / "scripts" / "setup.py"
LINE = "apt-get install -y --no-install-recommends libegl1"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def setup(tmp_path, monkeypatch) -> ModuleType:
    """The script as a module, with an environment of its own, on a machine with apt-get and without a GPU."""
    spec = importlib.util.spec_from_file_location("setup_script", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "VENV", tmp_path)
    monkeypatch.setattr(module.shutil, "which", lambda name: "/usr/bin/apt-get" if name == "apt-get" else None)
    monkeypatch.delenv("TORCH", raising=False)
    return module


@pytest.fixture
def ran(setup, monkeypatch, capsys) -> list[tuple[list[str], str]]:
    """Every command that was run, and what had been printed until then. All of them succeed."""
    commands: list[tuple[list[str], str]] = []
    printed: list[str] = []

    def run(command, **_):
        printed.append(capsys.readouterr().out)
        commands.append(([str(part) for part in command], "".join(printed)))
        return subprocess.CompletedProcess(command, 0, stdout="", stderr="")

    monkeypatch.setattr(setup.subprocess, "run", run)
    return commands


@pytest.mark.parametrize(
    ("uid", "stdin", "installs", "shown"),
    [
        (1000, Terminal(), False, f"sudo {LINE}"),
        (0, io.StringIO(), True, f"Installing system-wide, for pictures: {LINE}"),
        (0, Terminal("\n"), True, f"{LINE}\nInstall now? [Y/n]"),
        (0, Terminal("n\n"), False, f"{LINE}\nInstall now? [Y/n]"),
    ],
)
def test_system_packages_are_announced_to_root_asked_at_a_terminal_and_shown_to_others(
    setup, ran, monkeypatch, capsys, uid, stdin, installs, shown
):
    monkeypatch.setattr(setup.os, "geteuid", lambda: uid)
    monkeypatch.setattr(setup.sys, "stdin", stdin)
    assert setup.apt_install(["libegl1"], "pictures", "nothing can be seen") == installs
    assert [command for command, _ in ran] == ([["apt-get", "update"], LINE.split()] if installs else [])
    assert shown in (ran[0][1] if installs else "".join(capsys.readouterr()))


def test_a_machine_without_venv_is_asked_for_all_that_it_will_need_at_once(setup, monkeypatch):
    asked = []
    monkeypatch.setattr(setup, "PYTHON", Path("/nowhere/python"))
    monkeypatch.setattr(setup, "make_venv_with_pip", lambda: False)
    monkeypatch.setattr(setup.ctypes.util, "find_library", lambda name: None)
    monkeypatch.setattr(setup, "apt_install", lambda packages, *_: asked.append(packages))
    with pytest.raises(SystemExit):
        setup.make_venv()
    assert asked[0][0].endswith("-venv")
    assert asked[0][1:] == setup.GL_PACKAGES


def report(*needs: str) -> SimpleNamespace:
    message = {"install": [{"metadata": {"name": "torch", "requires_dist": ["filelock", *needs]}}]}
    return SimpleNamespace(returncode=0, stdout=json.dumps(message))


@pytest.mark.parametrize(
    ("done", "asked", "gpu", "installs"),
    [
        (report('nvidia-cudnn-cu13==9.20.0.48; platform_system == "Linux"'), None, False, False),
        (report("cuda-toolkit[cublas]==13.0.3"), "1", False, True),
        (report("cuda-toolkit[cublas]==13.0.3"), None, True, True),
        (report(), None, False, True),  # a build for CPUs
        (SimpleNamespace(returncode=0, stdout='{"install": []}'), None, False, True),  # installed already
        (SimpleNamespace(returncode=1, stdout=""), None, False, True),  # pip will say what is wrong
    ],
)
def test_pytorch_with_cuda_is_left_out_where_there_is_no_gpu(setup, monkeypatch, capsys, done, asked, gpu, installs):
    monkeypatch.setattr(setup.subprocess, "run", lambda *_, **__: done)
    if asked:
        monkeypatch.setenv("TORCH", asked)
    if gpu:
        monkeypatch.setattr(setup.shutil, "which", lambda name: f"/usr/bin/{name}")
    assert setup.with_torch(["dev"]) == ["dev", *["dev-torch"] * installs]
    assert ("make test TORCH=1" in capsys.readouterr().out) != installs


def test_the_version_that_is_asked_about_is_the_one_of_the_extra(setup):
    import tomllib

    message = tomllib.loads((FILE.parents[1] / "pyproject.toml").read_text())
    assert setup.TORCH in message["project"]["optional-dependencies"]["dev-torch"]


def test_what_dev_brought_along_is_not_installed_again(setup, ran, tmp_path):
    setup.install(["docs"])
    assert [command[-1] for command, _ in ran if "pip" in command] == [".[docs]"]
    del ran[:]
    (tmp_path / "installed-docs").unlink()
    (tmp_path / "installed-dev-dev-torch").write_text(setup.stamp_of(["dev", "dev-torch"]))
    setup.install(["docs"])
    assert ran == []
    setup.install(["ray"])
    assert [command[-1] for command, _ in ran if "pip" in command] == [".[ray]"]


@pytest.mark.parametrize("flag", ["--help", "-e"])
def test_a_flag_shows_how_to_use_it_and_installs_nothing(setup, ran, monkeypatch, flag):
    monkeypatch.setattr(setup.sys, "argv", ["setup.py", flag])
    with pytest.raises(SystemExit, match=r"setup.py \[EXTRA"):
        setup.main()
    assert ran == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "Installing cognitivedrone and its dependencies into {}: this takes a minute or two.\n"),
        (
            ["dev"],
            "Installing cognitivedrone[dev] and its dependencies into {}: this takes a minute or two, longer if PyTorch"
            " comes too.\n",
        ),
    ],
)
def test_what_is_installed_and_where_is_shown_before_anything_runs(setup, ran, monkeypatch, capsys, arguments, message):
    monkeypatch.setattr(setup, "PYTHON", setup.VENV / "bin" / "python")
    monkeypatch.setattr(setup, "ensure_sdformat", lambda: None)
    monkeypatch.setattr(setup, "with_torch", lambda extras: extras)
    monkeypatch.setattr(setup.sys, "argv", ["setup.py", *arguments])
    monkeypatch.setattr(setup.shutil, "rmtree", lambda *_, **__: None)
    setup.main()
    assert ran[0][1] == message.format(setup.VENV)
    before = ran[-1][1] + capsys.readouterr().out
    setup.main()  # installed by now
    assert ran[-1][1] + capsys.readouterr().out == before


def test_an_installation_that_was_killed_is_begun_anew_and_one_that_failed_is_not(setup, ran, monkeypatch):
    monkeypatch.setattr(setup, "PYTHON", setup.VENV / "bin" / "python")
    setup.PYTHON.parent.mkdir()
    setup.PYTHON.touch()
    killed = setup.VENV / "half-a-package"
    killed.touch()
    monkeypatch.setattr(setup.subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1))
    with pytest.raises(SystemExit, match="can be run again"):
        setup.install([])
    monkeypatch.setattr(setup, "run", lambda *_: True)
    setup.make_venv()
    assert killed.exists()
    (setup.VENV / "installing").touch()
    monkeypatch.setattr(setup, "make_venv_with_pip", lambda: True)
    setup.make_venv()
    assert not killed.exists()


def test_everything_is_installed_in_the_version_of_the_lock_file(setup, monkeypatch):
    seen = []

    def run(command, **options):
        if "pip" in command:
            seen.append((options["cwd"], options["env"]["PIP_CONSTRAINT"]))
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(setup.subprocess, "run", run)
    setup.install([])
    ((folder, name),) = seen
    assert (folder / name).read_text().startswith("# ")
