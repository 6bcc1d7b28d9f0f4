"""A Hugging Face Hub for tests: the part of its HTTP interface that small repositories need, in memory."""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, unquote, urlsplit

TOKEN = "hf_of_a_test"  # noqa: S105


@dataclass
class Repo:
    """Files at every commit."""

    private: bool = True
    commits: dict[str, dict[str, bytes]] = field(default_factory=lambda: {"0" * 40: {}})

    def at(self, revision: str) -> tuple[str, dict[str, bytes]] | None:
        commit = list(self.commits)[-1] if revision == "main" else revision
        return (commit, self.commits[commit]) if commit in self.commits else None

    def add(self, files: dict[str, bytes]) -> str:
        commit = hashlib.sha1(repr((list(self.commits)[-1], sorted(files))).encode()).hexdigest()  # noqa: S324
        self.commits[commit] = files
        return commit


@dataclass
class Hub:
    """Repositories by type and name, such as "model me/eyes"."""

    url: str = ""
    repos: dict[str, Repo] = field(default_factory=dict)
    objects: dict[str, bytes] = field(default_factory=dict)
    """Content of large files, by SHA-256."""
    requests: list[str] = field(default_factory=list)
    agents: set[str] = field(default_factory=set)
    lies: dict[str, bytes] = field(default_factory=dict)
    """What is sent instead of the files of these names."""
    broken: bool = False
    """Whether it refuses large files."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    hub: Hub

    def log_message(self, *_: object) -> None:
        pass

    def answer(self, status: int, body: object = None, **headers: str) -> None:
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(content)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            with suppress(ConnectionError):  # the client has had enough
                self.wfile.write(content)

    def handle_any(self) -> None:
        place = urlsplit(self.path)
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.hub.requests.append(f"{self.command} {self.path}")
        self.hub.agents.add(self.headers.get("User-Agent", ""))
        self.route(unquote(place.path), parse_qs(place.query), body)

    do_GET = do_HEAD = do_POST = do_PUT = handle_any  # noqa: N815

    def route(self, path: str, query: dict[str, list[str]], body: bytes) -> None:
        hub, allowed = self.hub, self.headers.get("Authorization") == f"Bearer {TOKEN}"
        parts = path.strip("/").split("/")
        if self.command == "PUT" and parts[0] == "lfs":
            if hub.broken or hashlib.sha256(body).hexdigest() != parts[1]:
                return self.answer(400, {"error": "another file"})
            hub.objects[parts[1]] = body
            return self.answer(200)
        if self.command == "POST" and not allowed:
            return self.answer(401, {"error": "log in"})
        if path == "/api/validate-yaml":
            return self.answer(200, {"errors": [], "warnings": []})
        if path == "/api/repos/create":
            wanted = json.loads(body)
            name = f"{wanted.get('organization') or 'me'}/{wanted['name']}"
            kind = wanted.get("type") or "model"
            url = f"{hub.url}/{'datasets/' if kind == 'dataset' else ''}{name}"
            if f"{kind} {name}" in hub.repos:
                return self.answer(409, {"error": "exists", "url": url})
            private = wanted.get("private", wanted.get("visibility") != "public")
            hub.repos[f"{kind} {name}"] = Repo(private)
            return self.answer(200, {"url": url})
        if parts[0] == "api":
            kind, name, rest = parts[1].removesuffix("s"), "/".join(parts[2:4]), parts[4:]
        else:
            kind = "dataset" if parts[0] == "datasets" else "model"
            parts = parts[kind == "dataset" :]
            name, rest = "/".join(parts[:2]).removesuffix(".git"), parts[2:]
        repo = hub.repos.get(f"{kind} {name}")
        if repo is None or (repo.private and not allowed):
            return self.answer(401, {"error": "no such repository"}, X_Error_Code="RepoNotFound")
        if rest[:2] == ["info", "lfs"]:
            found = [
                {**each, "actions": {"upload": {"href": f"{hub.url}/lfs/{each['oid']}"}}}
                for each in json.loads(body)["objects"]
            ]
            return self.answer(200, {"transfer": "basic", "objects": found})
        revision = rest[1] if len(rest) > 1 else "main"
        at = repo.at(revision)
        if at is None:
            return self.answer(404, {"error": "no such revision"}, X_Error_Code="RevisionNotFound")
        commit, files = at
        if rest[:1] == ["preupload"]:
            modes = [
                {"path": each["path"], "shouldIgnore": False, "uploadMode": self.mode_of(each["path"])}
                for each in json.loads(body)["files"]
            ]
            return self.answer(200, {"files": modes})
        if rest[:1] == ["commit"]:
            made = repo.add(self.changed(dict(files), body))
            return self.answer(200, {"commitUrl": f"{hub.url}/{name}/commit/{made}", "commitOid": made})
        if rest[:1] == ["tree"]:
            return self.answer(200, [self.entry(path, content) for path, content in files.items()])
        if rest[:1] == ["resolve"]:
            return self.resolve(commit, files, "/".join(rest[2:]))
        facts = {"id": name, "sha": commit, "siblings": [{"rfilename": each} for each in files]}
        return self.answer(200, {**facts, "private": repo.private, "tags": [], "downloads": 0})

    def mode_of(self, path: str) -> str:
        return "lfs" if path.endswith((".onnx", ".parquet")) else "regular"

    def changed(self, files: dict[str, bytes], body: bytes) -> dict[str, bytes]:
        for line in map(json.loads, body.splitlines()):
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                files[value["path"]] = self.hub.objects[value["oid"]]
            elif line["key"] == "deletedFile":
                del files[value["path"]]
        return files

    def entry(self, path: str, content: bytes) -> dict[str, object]:
        entry = {"type": "file", "path": path, "size": len(content), "oid": git_hash(content)}
        if self.mode_of(path) == "lfs":
            entry["lfs"] = {"oid": hashlib.sha256(content).hexdigest(), "size": len(content), "pointerSize": 130}
        return entry

    def resolve(self, commit: str, files: dict[str, bytes], path: str) -> None:
        if path not in files:
            return self.answer(404, {}, X_Error_Code="EntryNotFound")
        content = self.hub.lies.get(path, files[path])
        lfs = self.mode_of(path) == "lfs"
        tag = hashlib.sha256(files[path]).hexdigest() if lfs else git_hash(files[path])
        return self.answer(200, content, ETag=f'"{tag}"', X_Repo_Commit=commit)


def git_hash(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()  # noqa: S324


@contextmanager
def hub_server() -> Iterator[Hub]:
    """A running hub on loopback."""
    hub = Hub()
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"hub": hub}))
    server.daemon_threads = True
    hub.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield hub
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
