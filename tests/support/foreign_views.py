"""Makes this interpreter a foreign system for the package's modules; see `foreign.py`, which says what is lacking.

Only modules of the package import these views, through a `__import__` of their own: the standard library and other
packages go on as on Linux. Not like a foreign system: the renderer, paths, the speed, and what other packages do there.
"""

import builtins
import errno
import fcntl
import io
import json
import os
import select
import stat
import sys
import types
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from typing import Any

PACKAGE = "cognitivedrone"
SIGNALS = frozenset({2, 4, 6, 8, 11, 15})  # those that Windows' C library knows
BUSY = "The process cannot access the file because it is being used by another process"


class View(types.ModuleType):
    """A module without some of its names, and with others."""

    def __init__(self, name: str, lacking: frozenset[str], /, **other: Any) -> None:
        super().__init__(name)
        self.__dict__.update(_real=__import__(name) if other.pop("real", True) else None, _lacking=lacking, **other)

    def __getattr__(self, name: str) -> Any:
        if name in self._lacking or self._real is None:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        return getattr(self._real, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._real, name, value)


def install(system: str) -> None:
    """From now on, the package's modules find such a system."""
    table = json.loads(Path(os.environ["FOREIGN"]).read_text(encoding="utf-8"))
    lacking = {name: frozenset(names) for name, names in table["names"].items()}
    other = _windows() if system == "win32" else _macos()
    other.setdefault("sys", {})["platform"] = system
    other["platform"] = {"system": lambda: {"win32": "Windows", "darwin": "Darwin"}[system]}
    views = {name: View(name, lacking.get(name, frozenset()), **other.get(name, {})) for name in {*lacking, *other}}
    sys.meta_path.insert(0, finder := Finder(views, frozenset(table["modules"]) - {*other}))
    if system == "win32":
        _break_the_standard_library()
        finder.builtins["open"] = io.open


class Finder(MetaPathFinder):
    """Finds the package's modules, and has them import views."""

    def __init__(self, views: dict[str, View], absent: frozenset[str]) -> None:
        self.views, self.absent = views, absent
        self.builtins = {**vars(builtins), "__import__": self.load}

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """As the interpreter asks for it."""
        spec = PathFinder.find_spec(name, path, target) if name.partition(".")[0] == PACKAGE else None
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = Loader(spec.loader.name, spec.loader.path)
            spec.loader.finder = self
        return spec

    def load(self, name: str, globals_: Any = None, locals_: Any = None, names: Any = (), level: int = 0) -> Any:
        """What a module of the package gets for `import`."""
        if level == 0 and name in self.absent:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        first = name.partition(".")[0]
        if level == 0 and (name in self.views or (first in self.views and not names)):
            return self.views[first]
        return builtins.__import__(name, globals_, locals_, names, level)


class Loader(SourceFileLoader):
    """Loads a module whose `import` is the finder's."""

    finder: Finder

    def exec_module(self, module: types.ModuleType) -> None:
        """Run the module's code."""
        module.__dict__["__builtins__"] = self.finder.builtins
        super().exec_module(module)
        if module.__name__ == f"{PACKAGE}.system":
            module.OPENGL = {"egl": "", "osmesa": ""}  # the renderer is this machine's


class _Library:
    """A C library that has nothing beyond the standard."""


def _macos() -> dict[str, dict[str, Any]]:
    import ctypes
    import socket

    def pair(family: Any = None, kind: int = socket.SOCK_STREAM, *rest: int) -> Any:
        if kind == socket.SOCK_SEQPACKET:
            raise OSError(43, "Protocol not supported")
        return socket.socketpair(family, kind, *rest)

    library = _Library()
    return {
        "socket": {"socketpair": pair},
        "ctypes": {"CDLL": lambda name: ctypes.CDLL(name) if name else library},
    }


def _windows() -> dict[str, dict[str, Any]]:
    import signal
    import subprocess

    def open_file(path: Any, flags: int, mode: int = 0o777, *, dir_fd: None = None) -> int:
        if os.path.isdir(path):  # noqa: PTH112
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        if dir_fd is not None:
            raise NotImplementedError("dir_fd unavailable on this platform")
        return os.open(path, flags, mode)

    def sync(file: int) -> None:
        if fcntl.fcntl(file, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        os.fsync(file)

    def kill(process: int, number: int) -> None:
        os.kill(process, signal.SIGKILL if number == signal.SIGTERM else _known(number))

    def wait_for_sockets(*files: Any, **timeout: Any) -> Any:
        for file in (file for each in files[:3] for file in each):
            if not stat.S_ISSOCK(os.fstat(file if isinstance(file, int) else file.fileno()).st_mode):
                raise OSError(10038, "An operation was attempted on something that is not a socket")
        return select.select(*files, **timeout)

    class Popen(subprocess.Popen):
        def __init__(self, *rest: Any, creationflags: int = 0, pass_fds: Any = (), **more: Any) -> None:
            if pass_fds or more.get("preexec_fn"):
                raise ValueError("pass_fds not supported on Windows.")
            super().__init__(*rest, **more, start_new_session=bool(creationflags))

    def locking(file: int, mode: int, count: int) -> None:
        try:
            fcntl.flock(file, mode)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, "Permission denied") from None

    def peek(pipe: int, size: int) -> tuple[int, int]:
        if not stat.S_ISFIFO(os.fstat(pipe).st_mode):
            raise OSError(errno.EINVAL, "The handle is invalid")
        return len(select.select([pipe], [], [], 0)[0]), 0

    def no_key(*_: object) -> Any:
        raise FileNotFoundError(errno.ENOENT, "The system cannot find the file specified")

    kernel = types.SimpleNamespace(SetConsoleCtrlHandler=lambda handler, ignore: signal.pthread_sigmask(
        signal.SIG_BLOCK if ignore else signal.SIG_UNBLOCK, [signal.SIGINT]))  # fmt: skip
    return {
        "os": {"open": open_file, "fsync": sync, "kill": kill, "name": "nt", "O_BINARY": 0},
        "signal": {"signal": lambda number, handler: signal.signal(_known(number), handler)},
        "select": {"select": wait_for_sockets},
        "subprocess": {"Popen": Popen, "CREATE_NEW_PROCESS_GROUP": 512},
        "ctypes": {"windll": types.SimpleNamespace(kernel32=kernel)},
        "msvcrt": {"real": False, "locking": locking, "LK_NBLCK": fcntl.LOCK_EX | fcntl.LOCK_NB,
                   "LK_UNLCK": fcntl.LOCK_UN, "get_osfhandle": int},
        "_winapi": {"real": False, "PeekNamedPipe": peek},
        "winreg": {"real": False, "OpenKey": no_key, "HKEY_LOCAL_MACHINE": 0},
    }  # fmt: skip


def _known(number: int) -> int:
    if number not in SIGNALS:
        raise ValueError("invalid signal value")
    return number


def _break_the_standard_library() -> None:
    """As on Windows, what reaches us through pathlib, shutil and tempfile: open files, the ends of lines, cp1252."""
    for name in ("replace", "rename", "unlink", "remove"):
        setattr(os, name, _unless_open(getattr(os, name)))
    plain = io.open

    def as_there(file: Any, mode: str = "r", buffering: int = -1, encoding: Any = None, *rest: Any, **more: Any) -> Any:
        if "b" not in mode and encoding is None:
            encoding = "cp1252"
        if "b" not in mode and not rest and more.get("newline") is None and mode[0] in "wax":
            more["newline"] = "\r\n"
        return plain(file, mode, buffering, encoding, *rest, **more)

    io.open = as_there


def _unless_open(real: Any) -> Any:
    """The function, but not for what somebody holds open, nor a folder onto another."""

    def call(path: Any, *rest: Any, dir_fd: int | None = None, **more: Any) -> Any:
        base = "" if dir_fd is None else f"/proc/self/fd/{dir_fd}"
        targets = [str(Path(base, os.fsdecode(path)).absolute()), *(str(Path(each).absolute()) for each in rest[:1])]
        if rest and Path(targets[1]).is_dir():
            raise PermissionError(errno.EACCES, "Access is denied", targets[0], None, targets[1])
        if "/pym" not in targets[0] and (held := _held(targets)):
            raise PermissionError(errno.EACCES, f"{BUSY} ({held})", targets[0])
        return real(path, *rest, **more, **({} if dir_fd is None else {"dir_fd": dir_fd}))

    return call


def _held(paths: list[str]) -> str:
    """The first of these paths that a process has open, or a file within it."""
    for file in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            found = str(file.readlink())
        except OSError:
            continue
        if any(found == path or found.startswith(f"{path}/") for path in paths):
            return found
    return ""
