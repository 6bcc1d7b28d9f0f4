"""The lines of docs/play.md for nginx and for ssh, run: the page opens through them, and nobody else's script."""

import contextlib
import getpass
import os
import re
import shlex
import shutil
import socket
import socketserver
import subprocess
import threading
import time
from pathlib import Path

import pytest
from tests.play.test_page import Recorded, ask, live, port_of
from waiting import free_port

from cognitivedrone.play.config import PageSpec
from cognitivedrone.play.server import Channels, serving_page

DOCS = (Path(__file__).parents[2] / "docs" / "play.md").read_text("utf-8")
PATH = f"{os.environ['PATH']}:/usr/sbin"
FOREIGN = {"Origin": "https://evil.example"}


@contextlib.contextmanager
def running(*command):
    """A program in the block."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=60)


def wait_for(port, process):
    """Wait until something listens at a port. Fails with what the program printed, if that ended."""
    for _ in range(600):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        if process.poll() is not None:
            pytest.fail(process.communicate()[0].decode())
        time.sleep(0.05)
    pytest.fail("nothing listens")


def opens(address, headers):
    """The page, its script and its websocket; another page's script is refused."""
    for path in ("", "static/app.js"):
        assert ask(address, path, headers=headers)[0] == 200
    with live(address, additional_headers={name: value for name, value in headers.items() if name != "Host"}) as socket:
        assert isinstance(socket.recv(timeout=60), str | bytes)
    assert ask(address, "static/app.js", headers=headers | FOREIGN)[0] == 403


def test_the_lines_for_nginx_open_the_page(tmp_path):
    nginx = shutil.which("nginx", path=PATH)
    if nginx is None:
        pytest.skip("nginx is not installed (apt install nginx)")
    (lines,) = re.findall(r"```nginx\n(.*?)```", DOCS, re.S)
    (origin,) = re.findall(r"In nginx, with `cognitivedrone play --origin (\S+)", DOCS)
    channels, port = Channels(), free_port()
    channels.publish("state", {"number": 1})
    with serving_page(PageSpec(port=0, browser=False, origin=(origin,)), channels, Recorded(), None) as address:
        server = f"server {{ listen 127.0.0.1:{port}; {lines.replace('8090', str(port_of(address)))} }}"
        folders = "".join(
            f"{each}_temp_path {tmp_path}/{each};" for each in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
        )
        user = "user root root;" if os.getuid() == 0 else ""
        (tmp_path / "nginx.conf").write_text(
            f"{user} daemon off; pid {tmp_path}/pid; error_log stderr; events {{}}\n"
            f"http {{ access_log off; {folders} {server} }}\n"
        )
        with running(nginx, "-p", str(tmp_path), "-e", "stderr", "-c", str(tmp_path / "nginx.conf")) as process:
            wait_for(port, process)
            near, sent = f"http://127.0.0.1:{port}/", {"Host": origin.partition("//")[2], "Origin": origin}
            opens(near, sent)
            status, said = ask(near, "picture/0?name=a.png", data=bytes(20_000_000), headers=sent)
            assert status != 413
            assert "takes pictures" in said.decode()  # the page's own answer


class Forwarder(socketserver.ThreadingTCPServer):
    """Forwards every connection to a port, byte by byte, as a tunnel does."""

    daemon_threads = True

    def __init__(self):
        self.far = 0
        super().__init__(("127.0.0.1", 0), None)

    def finish_request(self, request, client_address):
        with socket.create_connection(("127.0.0.1", self.far)) as far:
            back = threading.Thread(target=self._copy, args=(far, request))
            back.start()
            self._copy(request, far)
            back.join()

    def _copy(self, source, target):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_WR)


@contextlib.contextmanager
def forwarding(forwarder, far):
    """Run a forwarder to a port in the block."""
    forwarder.far = far
    thread = threading.Thread(target=forwarder.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield
    finally:
        forwarder.shutdown()
        thread.join()


@contextlib.contextmanager
def tunnelled(folder, forward):
    """`ssh -L FORWARD` to a server of its own on this host."""
    ssh, sshd, keygen = (shutil.which(name, path=PATH) for name in ("ssh", "sshd", "ssh-keygen"))
    if ssh is None or sshd is None or keygen is None:
        pytest.skip("ssh and its server are not installed (apt install openssh-server)")
    for name in ("host", "user"):
        subprocess.run([keygen, "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    options = {
        "HostKey": folder / "host", "AuthorizedKeysFile": folder / "user.pub", "PidFile": "none", "UsePAM": "no",
        "StrictModes": "no", "PermitRootLogin": "yes", "ListenAddress": "127.0.0.1",
    }  # fmt: skip
    config, port = folder / "sshd_config", free_port()
    config.write_text("".join(f"{name} {value}\n" for name, value in options.items()))
    if (checked := subprocess.run([sshd, "-t", "-f", config], capture_output=True, text=True, check=False)).returncode:
        pytest.skip(f"sshd cannot be started here: {checked.stderr.strip()}")
    trust = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "ExitOnForwardFailure=yes")
    trusting = [word for option in trust for word in ("-o", option)]
    with running(sshd, "-D", "-e", "-f", str(config), "-p", str(port)) as server:
        wait_for(port, server)
        login = ["-F", "none", "-i", str(folder / "user"), "-p", str(port), "-N", *trusting, "-L", forward]
        with running(ssh, *login, f"{getpass.getuser()}@127.0.0.1") as client:
            wait_for(int(forward.partition(":")[0]), client)
            yield


@pytest.mark.parametrize("tunnel", ["plain", "ssh"])
def test_the_line_for_ssh_opens_the_page(tunnel, tmp_path):
    (line,) = re.findall(r"^ssh -L .*$", DOCS, re.M)
    ssh, option, forward, _, program, command, *rest = shlex.split(line)
    assert (ssh, option, program, command, rest[0]) == ("ssh", "-L", "cognitivedrone", "play", "--origin")
    near, host, far = forward.split(":")
    assert (host, far, rest[1]) == ("localhost", "8090", f"http://localhost:{near}")
    assert PageSpec().port == int(far)
    with contextlib.ExitStack() as stack:
        forwarder = stack.enter_context(Forwarder())
        port = forwarder.server_address[1] if tunnel == "plain" else free_port()
        origin, channels = rest[1].replace(near, str(port)), Channels()
        channels.publish("state", {"number": 1})
        spec = PageSpec(port=0, browser=False, origin=(origin,))
        address = stack.enter_context(serving_page(spec, channels, Recorded(), None))
        own = port_of(address)
        stack.enter_context(
            forwarding(forwarder, own) if tunnel == "plain" else tunnelled(tmp_path, f"{port}:{host}:{own}")
        )
        opens(f"{origin}/", {"Origin": origin})
