"""Try the package on an emulated ARM64 Debian: installation, four tasks, a few decisions. Standard library only.

Usage: sudo python3 scripts/test_arm64.py [--system FOLDER] [--episodes 4]

Needs Linux, root, qemu-aarch64-static and debootstrap (Debian: apt-get install qemu-user-static debootstrap). The
minimal system is made once, in FOLDER (build/arm64). It sees this machine's network and none of its other files. ARM64
programs are known to the kernel only inside of it, in a user namespace of its own: nothing outside changes.

The expert flies the tasks: in the emulator, the networks take up to a minute for a decision, so they make three.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SYSTEM = ROOT / "build" / "arm64"
EMULATOR = "qemu-aarch64-static"
PACKAGES = "ca-certificates,libegl1,libgl1-mesa-dri,libopengl0,python3-venv"
DEVICES = {"null": (1, 3), "zero": (1, 5), "full": (1, 7), "random": (1, 8), "urandom": (1, 9), "tty": (5, 0)}
DEVICES |= {"console": (5, 1), "ptmx": (5, 2)}
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
MAGIC = (
    r"\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00:"
    r"\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff"
)
"""How a 64-bit ARM program begins, and which bits of that count."""
DECISIONS = """
import numpy as np
from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.policies import make_policy
from cognitivedrone.types import EpisodeContext, Observation
env = CognitiveDroneEnv(suite="open-v1:smoke")
seen, info = env.reset(options={"episode": 0})
instruction = info["task"].instruction
policy = make_policy("small")
policy.reset(EpisodeContext(instruction))
for step in range(3):
    action = policy.act(Observation(seen["image"], instruction, seen["velocity"], 1.0, 0.0, step / 10))
    print(instruction, action.round(3).tolist(), flush=True)
    assert np.isfinite(action).all() and action[0, 0] > 0.3
"""
"""The packaged policy is shown the first frame of a task, three times, and flies ahead."""
WITHIN = r"""
read -r _ # the users of the namespace are there now
mount -t proc proc /proc
mount -t binfmt_misc none /proc/sys/fs/binfmt_misc
printf '%s' "$RULE" > /proc/sys/fs/binfmt_misc/register
exec "$@"
"""


def missing() -> str:
    """Why it cannot be tried on this machine; empty if it can."""
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        return "only for Linux on x86-64"
    lacking = [name for name in (EMULATOR, "debootstrap", "unshare") if shutil.which(name) is None]
    if lacking:
        return f"{', '.join(lacking)} not installed"
    return "" if os.geteuid() == 0 else "only root can make another system"


def within(*command: object) -> int:
    """Exit status of a command in namespaces where the kernel starts ARM64 programs by the emulator."""
    environment = {name: value for name, value in os.environ.items() if name.lower().endswith("_proxy")}
    environment |= {"PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin", "HOME": "/root", "LC_ALL": "C.UTF-8"}
    environment |= {"RULE": f":arm64:M::{MAGIC}:{shutil.which(EMULATOR)}:F", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    apart = ["unshare", "--user", "--mount", "--pid", "--fork", "--kill-child", "sh", "-ec", WITHIN, "sh"]
    child = subprocess.Popen([*apart, *map(str, command)], stdin=subprocess.PIPE, env=environment)
    outside = Path("/proc/self/ns/user").readlink()
    while child.poll() is None and Path(f"/proc/{child.pid}/ns/user").readlink() == outside:
        time.sleep(0.01)
    for kind in ("uid_map", "gid_map"):
        Path(f"/proc/{child.pid}/{kind}").write_text("0 0 65536")
    child.communicate(b"\n")
    return child.returncode


def make_system(folder: Path) -> None:
    """A minimal Debian; a folder that another start left unfinished is begun anew."""
    if (folder / "made").exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "dev").mkdir(parents=True)
    for name, (major, minor) in DEVICES.items():  # inside of the namespace nobody may make any
        subprocess.run(["mknod", "-m", "666", folder / "dev" / name, "c", str(major), str(minor)], check=True)
    # Its check whether devices can be made would fail there, too.
    text = Path(shutil.which("debootstrap") or "").read_text(encoding="utf-8")
    program = folder.with_name("debootstrap")
    program.write_text(text.replace('! check_sane_mount "$TARGET"', "false"), encoding="utf-8")
    step("system", "sh", program, "--arch=arm64", "--variant=minbase", f"--include={PACKAGES}", "stable", folder)
    if CERTIFICATES.exists():  # of a network that has one of its own
        shutil.copy(CERTIFICATES, folder / CERTIFICATES.relative_to("/"))
    (folder / "made").touch()


def step(what: str, *command: object) -> None:
    """Run a command in the namespaces and say how long it took; end with its exit status where it fails."""
    print(f"== {what}", flush=True)
    began = time.monotonic()
    if status := within(*command):
        sys.exit(f"{what} failed with exit status {status}: {' '.join(map(str, command))}")
    print(f"== {what}: {time.monotonic() - began:.0f} s", flush=True)


def copy_sources(folder: Path) -> None:
    """The files of this checkout that Git knows."""
    shutil.rmtree(folder, ignore_errors=True)
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--system", type=Path, default=SYSTEM, help="folder of the minimal system; made where missing")
    parser.add_argument("--episodes", type=int, default=4, help="tasks to fly")
    options = parser.parse_args()
    if reason := missing():
        sys.exit(f"cannot be tried here: {reason}; see {Path(__file__).name} --help")
    system: Path = options.system.resolve()
    make_system(system)
    shutil.copy("/etc/resolv.conf", system / "etc" / "resolv.conf")
    copy_sources(system / "opt" / "cognitivedrone")
    here = ["chroot", system]
    step("environment", *here, "python3", "-m", "venv", "--clear", "/opt/venv")
    install = ["/opt/venv/bin/pip", "install", "--quiet", "--no-compile", "--only-binary", ":all:"]
    step("installation", *here, *install, "/opt/cognitivedrone[serve,mavlink]")
    fly = ["/opt/venv/bin/cognitivedrone", "bench", "--suite", "open-v1:smoke", "--policy", "oracle"]
    fly += ["--workers", "1", "--clips", "0"]
    step("tasks", *here, *fly, "--episodes", options.episodes, "--out", "/opt/smoke", "--overwrite")
    results = json.loads((system / "opt" / "smoke" / "results.json").read_text(encoding="utf-8"))
    print(json.dumps(results["platform"], indent=1))
    if results["platform"]["machine"] != "aarch64":
        sys.exit("not flown on ARM64")
    if (passed := results["scores"]["through"]["overall"]["passed"]) < options.episodes:
        sys.exit(f"only {passed} of {options.episodes} tasks were passed")
    step("decisions", *here, "/opt/venv/bin/python3", "-c", DECISIONS)


if __name__ == "__main__":
    main()
