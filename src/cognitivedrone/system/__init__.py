"""What differs between Linux, macOS and Windows, the only place that asks which it is (`tests/system/test_system.py`).

Terminals are in `keys.py`. Functions are named for what they do; each says what happens where a system lacks it. Three
well-kept libraries were weighed: `psutil` is asked for free memory, in an extra that brings it anyway; `filelock` and
`portalocker` open files of their own by name, and what is locked here is open already, or a folder. What takes long to
import is imported in functions: this module comes before Ctrl-C is handled.
"""

from __future__ import annotations

import faulthandler
import functools
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Literal, TextIO

if sys.platform == "win32":
    import msvcrt
    import winreg
else:
    import fcntl
    import resource

# The machine.

NVIDIAS_DRIVER: Final = Path("/proc/driver/nvidia/version")
"""Is there where NVIDIA's driver is loaded; nowhere but on Linux."""


def name() -> str:
    """The system's name in files of results: Linux, Darwin (macOS) or Windows."""
    import platform

    return platform.system()


def refusal(what: str) -> str:
    """Why this system cannot do something for which it lacks too much, and the way out; empty on Linux and macOS."""
    if sys.platform != "win32":
        return ""
    return f"{what} needs Linux or macOS; on Windows, run it in WSL2 (wsl --install, then as on Ubuntu)"


def has_screen() -> bool:
    """Whether a browser has a window to open in: without one, it would take over the terminal."""
    if sys.platform in ("win32", "darwin") or "WSL_DISTRO_NAME" in os.environ:
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def cores() -> int:
    """Processor cores that this process may use; all of the machine's where a system restricts no process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def processor(root: Path = Path("/")) -> str:
    """The processor's name: of Linux's list, else the board's in the device tree, sysctl's or the registry's.

    "unknown" if the system tells none.
    """
    import platform
    import subprocess

    with suppress(OSError):
        text = (root / "proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
        for line in text.splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    with suppress(OSError):
        return (root / "proc/device-tree/model").read_text(encoding="utf-8", errors="replace").strip("\0 \n")
    with suppress(OSError):
        if sys.platform == "win32":
            key = winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"HARDWARE\DESCRIPTION\System\CentralProcessor\0")
            return str(winreg.QueryValueEx(key, "ProcessorNameString")[0]).strip()
        if sys.platform == "darwin":
            command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
            return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()  # noqa: S603
    return platform.processor() or "unknown"


def limit(of: Literal["NOFILE", "AS", "NPROC"]) -> int | None:
    """The shell's limit of open files, bytes of memory or processes; None for no limit, as always on Windows."""
    if sys.platform == "win32":
        return None
    found, _ = resource.getrlimit(getattr(resource, f"RLIMIT_{of}"))
    return None if found == resource.RLIM_INFINITY else found


def steady_s() -> float:
    """Seconds of a clock that goes on while the machine sleeps, from any beginning."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    # Those of Windows and, by this number, of macOS go on.
    return time.clock_gettime(time.CLOCK_MONOTONIC) if hasattr(time, "clock_gettime") else time.monotonic()


OPENGL: Final[dict[str, str]] = (
    {"wgl": "the driver of your graphics card, or in a virtual machine Mesa's opengl32.dll beside python.exe"}
    if sys.platform == "win32"
    else {"cgl": "log in at the Mac's own screen once, and start this again; nothing needs to be installed"}
    if sys.platform == "darwin"
    else {
        "egl": "apt-get install -y libegl1 libgl1-mesa-dri libopengl0",
        "osmesa": "apt-get install -y libosmesa6",
    }
)
"""The ways to render without a window, first choice first, and what to do where one does not work."""
OPENGL_TEST: Final[tuple[float, str]] = (
    (30.0, "as while nobody is logged in at the Mac's own screen: log in there")
    if sys.platform == "darwin"
    else (120.0, "as on a machine that is busy or swaps")
)
"""Seconds after which such a test is given up, and what such a case is like."""
DEVICES, CAMERA, CAMERA_FORMAT = (
    ("dshow:", "dshow:video=NAME (ffmpeg -list_devices true -f dshow -i dummy)", "dshow")
    if sys.platform == "win32"
    else ("avfoundation:", "avfoundation:0", "avfoundation")
    if sys.platform == "darwin"
    else ("/dev/", "/dev/videoN", "v4l2")
)
"""How the name of a camera of this machine begins, what it looks like, and FFmpeg's name of such devices."""

# Files and folders.

OURS: Final = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Flag to open a file for this process alone and byte by byte."""
NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)
"""Flag to open no symbolic link; Windows has none, and lets only administrators and developers make such links."""
NO_WAIT: Final = getattr(os, "O_NONBLOCK", 0)
"""Flag to wait for no writer of a pipe; on Windows no file is a pipe."""
FOLDER: Final = getattr(os, "O_DIRECTORY", 0)
"""Flag to open only a folder, where `OPENS_FOLDERS`."""
OPENS_FOLDERS: Final = sys.platform != "win32"
"""Whether a folder can be opened, to lock it, to sync it, or to name files from there."""
MOVES_OPEN_FILES: Final = sys.platform != "win32"
"""Whether a file can be renamed, replaced or removed while somebody has it open."""
TO_SYNC: Final = os.O_RDONLY if sys.platform != "win32" else os.O_RDWR
"""How a file must be open so that `os.fsync` works."""
_LOCKED_BYTE: Final = 0x7FFF_FFFE
_TAKEN: Final = PermissionError if sys.platform == "win32" else BlockingIOError


def lock(descriptor: int) -> bool:
    """Take the exclusive lock of what is open; False if another process has it. Raises `OSError` without locks.

    The system frees it when the last copy is closed. On Windows it is that of a byte far behind the end of a file.
    """
    try:
        if sys.platform == "win32":
            with _at_the_locked_byte(descriptor):
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except _TAKEN:
        return False
    return True


def unlock(descriptor: int) -> None:
    """Free the lock also where a forked process has a copy of the descriptor."""
    if sys.platform == "win32":
        with _at_the_locked_byte(descriptor):
            msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


@contextmanager
def _at_the_locked_byte(descriptor: int) -> Iterator[None]:
    before = os.lseek(descriptor, 0, os.SEEK_CUR)
    os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
    try:
        yield
    finally:
        os.lseek(descriptor, before, os.SEEK_SET)


def sync_folder(path: Path) -> None:
    """Have a new name in a folder survive a power failure; Windows sees to that itself."""
    if OPENS_FOLDERS:
        descriptor = os.open(path, os.O_RDONLY | FOLDER)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def move_folder(folder: Path, path: Path) -> None:
    """Give a folder a name that is free or an empty folder's; on Windows, that one is removed first."""
    if sys.platform == "win32" and path.is_dir():
        path.rmdir()
    folder.replace(path)


def is_mine(facts: os.stat_result) -> bool:
    """Whether this user owns a file; on Windows, where temporary folders are each user's own, every file."""
    return not hasattr(os, "geteuid") or facts.st_uid == os.geteuid()


def is_private(facts: os.stat_result) -> bool:
    """Whether nobody but this user may use a file or folder by its mode; on Windows, every one: it has no such mode."""
    return not hasattr(os, "geteuid") or (is_mine(facts) and not facts.st_mode & 0o077)


# Signals.

HANG_UP: Final[int] = getattr(signal, "SIGHUP", 0)
"""The signal of a terminal that has gone; 0 where there is none."""
ENDED: Final[dict[int, str]] = {
    number: why
    for name_, why in (
        ("SIGINT", "ctrl-C"), ("SIGTERM", "asked to terminate"), ("SIGHUP", "the terminal has gone"),
        ("SIGBREAK", "the console was closed"),
    )
    if (number := getattr(signal, name_, None)) is not None
}  # fmt: skip
"""The signals that ask a program to end, those that this system has, and what each says."""
FROM_OUTSIDE: Final[tuple[int, ...]] = (getattr(signal, "SIGKILL", signal.SIGTERM), *ENDED)
"""Signals sent from outside: by the out-of-memory killer, a person, or a batch system."""


@contextmanager
def sparing_children() -> Iterator[None]:
    """Processes started here never get a Ctrl-C, which reaches all of a terminal: this process handles it.

    On Windows a Ctrl-C in this very moment is lost for this process, too.
    """
    if sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.SetConsoleCtrlHandler(None, 1)
        try:
            yield
        finally:
            ctypes.windll.kernel32.SetConsoleCtrlHandler(None, 0)
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # a Python process too; starting it later would lift the mask
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def is_spared() -> bool:
    """Whether this process is one that `sparing_children` started, or blocks Ctrl-C itself."""
    if sys.platform == "win32":
        import multiprocessing

        return multiprocessing.parent_process() is not None
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def after_fork(child: Callable[[], object]) -> None:
    """Call `child` in every forked child; nothing where no process forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=child)


def c_library() -> Any:
    """The C library that is loaded; what it has beyond the C standard is to be asked for. None on Windows."""
    import ctypes

    return None if sys.platform == "win32" else ctypes.CDLL(None)


def show_threads_on_request(file: TextIO | None) -> None:
    """Have `ask_for_threads` write what this process is doing to a file; with None no more. Nothing on Windows."""
    if sys.platform != "win32":
        faulthandler.unregister(signal.SIGUSR1) if file is None else faulthandler.register(signal.SIGUSR1, file)


def ask_for_threads(process: int) -> None:
    """Have a process that called `show_threads_on_request` write, even if its interpreter is blocked."""
    if sys.platform != "win32":
        os.kill(process, signal.SIGUSR1)


# Processes.

_PR_SET_PDEATHSIG: Final = 1
_STARTER: Final = "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9); os.execvp(sys.argv[1], sys.argv[1:])"


def end_with_starter() -> None:
    """Have the kernel end this process with the thread that started it, however; nothing where only Linux does so."""
    if sys.platform == "linux":
        c_library().prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def ending_with_us(command: Sequence[str]) -> list[str]:
    """The command of a program that Linux kills when we end, however we end; elsewhere only what ends it does.

    Left alone, ArduCopter would wait for its next step of physics for ever, and keep its ports.
    """
    start = [sys.executable, "-I", "-S", "-c", _STARTER] if sys.platform == "linux" else []
    return [*start, *command]


def end_here() -> None:
    """End this process, without another line of Python."""
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))


def own_session() -> dict[str, Any]:
    """Arguments of `Popen` for a program that neither Ctrl-C at our terminal nor its end reaches."""
    if sys.platform == "win32":
        import subprocess

        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def inheriting(descriptors: Sequence[int]) -> dict[str, Any]:
    """Arguments of `Popen` for a program that has copies of these; on Windows it has none, so no lock either."""
    return {} if sys.platform == "win32" else {"pass_fds": tuple(descriptors)}


def tell_session(leader: int, what: Literal["TERM", "KILL"]) -> None:
    """Send a signal to a program of `own_session` and all that it started; on Windows each one ends it alone."""
    with suppress(ProcessLookupError):
        if sys.platform == "win32":
            os.kill(leader, signal.SIGTERM)
        else:
            os.killpg(leader, getattr(signal, f"SIG{what}"))


def end_of(process: int) -> int:
    """A file that becomes readable when a process ends; -1 where the system has none."""
    try:
        return os.pidfd_open(process)
    except (AttributeError, OSError):
        return -1


def come_first() -> None:
    """Ask to run before others and to stay in memory; nothing without the permission, or where it cannot be asked."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except (AttributeError, OSError):
        with suppress(AttributeError, OSError):
            os.setpriority(os.PRIO_PROCESS, 0, -10)
    # Under a limit, memory that is asked for later would be refused instead.
    if sys.platform == "linux" and (
        os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    ):
        with suppress(OSError, AttributeError):
            c_library().mlockall(1 | 2 | 4)  # MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT


_ROOM: Final = 1 << 18  # bytes; macOS gives 8 KiB


def message_pair() -> tuple[socket.socket, socket.socket, bool]:
    """Two connected local sockets; whether they are mere streams, as where no sockets carry whole messages."""
    try:
        return *socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET), False
    except (AttributeError, OSError):
        ours, theirs = socket.socketpair()
    for end in (ours, theirs):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _ROOM)
    return ours, theirs, True


def let_others_first(niceness: int) -> None:
    """Have other processes run before this one; nothing on Windows."""
    if hasattr(os, "nice"):
        os.nice(niceness)


DO_NOT_WAIT: Final[int] = getattr(socket, "MSG_DONTWAIT", 0)
"""Flag of `send` to raise `BlockingIOError` at once; none on Windows."""
