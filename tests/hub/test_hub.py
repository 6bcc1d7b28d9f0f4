"""Models and data sets pushed to a hub over HTTP by huggingface_hub, and pulled again; and what is refused."""

import json
import os
import shutil
import sys
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hub_server import TOKEN, Hub, Repo, hub_server
from tests.data.factory import make_episode
from tests.data.made_stores import write_store
from tiny import open_model_file, tiny_reasoner

from cognitivedrone.cli import main
from cognitivedrone.data.formats import export
from cognitivedrone.data.store import Store
from cognitivedrone.data.verify import verify
from cognitivedrone.errors import HubError
from cognitivedrone.hub import _LOADERS, _api, check_names, contents_of, kind_of
from cognitivedrone.models.eyes.sight import LOOKS

constants = pytest.importorskip("huggingface_hub.constants")
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content:DeprecationWarning")  # of the library's upload
MODELS = {"eyes.onnx", "gate_selector.onnx", "language.onnx", "text_encoder.onnx", "word_pieces.onnx"}


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    """An empty hub; large files go to it by Git LFS, because the service behind Xet has no small part."""
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no token"))
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    with hub_server() as running:
        monkeypatch.setenv("HF_ENDPOINT", running.url)
        yield running


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("made") / "store", [make_episode(index) for index in range(3)])


@pytest.fixture
def reader(tmp_path: Path) -> Path:
    """A small reasoner's folder with what a training run leaves beside it."""
    folder = tmp_path / "run"
    folder.mkdir()
    reading = np.zeros((4, 2), np.float32), np.zeros((3, LOOKS), np.float32), np.zeros((4, 4), np.float32)
    tiny_reasoner(folder, ("kind/thing", "concept/thing:cat"), reading=reading, logits=(0, 0, 0, 0))
    (folder / "recipe.json").write_text("{}")
    (folder / "state.pt").write_bytes(b"pickle")
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {each.relative_to(folder).as_posix(): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


def said_of(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one sentence with which a command ends."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    assert end.value.code == 2
    expected = capsys.readouterr()
    assert "Traceback" not in expected.err
    assert TOKEN not in expected.out + expected.err
    return " ".join(expected.err.split())


def test_a_reasoner_comes_back_as_it_was_and_at_the_commit_asked_for(hub, reader, tmp_path, capfd):
    main(["hub", "push", str(reader), "me/eyes"])
    first = capfd.readouterr()
    (reader / "recipe.json").unlink()
    main(["hub", "push", str(reader), "me/eyes"])
    main(["hub", "pull", "me/eyes", str(tmp_path / "new")])
    (commit,) = [each for each in list(hub.repos["model me/eyes"].commits)[1:] if each in first.out]
    main(["hub", "pull", "me/eyes", str(tmp_path / "old"), "--revision", commit])
    models = {name: (reader / name).read_bytes() for name in MODELS}
    assert content(tmp_path / "new") == models
    assert content(tmp_path / "old") == models | {"recipe.json": b"{}"}
    record = json.loads((tmp_path / "old.hub.json").read_text())
    assert record == {"name": "me/eyes", "kind": "reasoner", "revision": commit, "endpoint": hub.url, "files": 6,
                      "bytes": sum(map(len, content(tmp_path / "old").values()))}  # fmt: skip
    assert hub.repos["model me/eyes"].private
    said = capfd.readouterr()
    assert TOKEN not in first.out + first.err + said.out + said.err
    assert "5/5" in said.err  # a progress bar
    assert os.environ["HF_HUB_DISABLE_TELEMETRY"] == "1"
    assert not any("telemetry" in request for request in hub.requests)


def test_a_policy_is_shared_with_its_text_encoder_and_a_reasoner_with_all_of_its_files(reader):
    open_model_file(reader / "model.onnx")
    assert kind_of(reader) == ("model", "policy and reasoner")
    (reader / "gate_selector.onnx").unlink()  # as a policy's training writes it
    assert kind_of(reader) == ("model", "policy")
    (reader / "model.onnx").unlink()
    with pytest.raises(HubError, match=r"needs eyes\.onnx, gate_selector\.onnx and language\.onnx"):
        kind_of(reader)


def test_data_sets_come_back_as_they_were(hub, store, tmp_path):
    forms = {"data set": store}
    for form, kind in (("lerobot", "LeRobot data set"), ("rlds", "RLDS data set")):
        export(Store.open(store).labelled(), form, tmp_path / form)
        forms[kind] = tmp_path / form
    for number, (kind, folder) in enumerate(forms.items()):
        assert kind_of(folder) == ("dataset", kind)
        main(["hub", "push", str(folder), f"me/set{number}", "--public"])
        repo = hub.repos[f"dataset me/set{number}"]
        assert not repo.private
        repo.add(list(repo.commits.values())[-1] | {".gitattributes": b"* text", "README.md": b"A card."})
        out = tmp_path / f"pulled{number}"
        main(["hub", "pull", f"{'datasets/' if number else ''}me/set{number}", str(out)])
        assert content(out) == {name: data for name, data in content(folder).items() if name != "README.md"}
    assert verify(tmp_path / "pulled0") == []


def test_a_dry_run_lists_what_a_push_would_send_and_sends_nothing(hub, reader, capsys):
    main(["hub", "push", str(reader), "me/eyes", "--dry-run"])
    said = capsys.readouterr().out
    assert "2 B  recipe.json" in said
    assert "a reasoner of 6 files" in said
    assert "state.pt" not in said
    assert hub.requests == []


@pytest.mark.parametrize(
    ("files", "lies", "message"),
    [
        ({"modeling.py": b"import os"}, {}, "'modeling.py' is not shared: it may hold code"),
        ({"state.pt": b"pickle"}, {}, "'state.pt' is not shared"),
        ({"../evil.json": b"{}"}, {}, "'../evil.json' is not shared: names are"),
        ({"/etc/evil.json": b"{}"}, {}, "'/etc/evil.json' is not shared"),
        ({".cache/evil.json": b"{}"}, {}, "'.cache/evil.json' is not shared"),
        ({"bell\x07.json": b"{}"}, {}, "is not shared"),
        ({"config.json": b"{}"}, {}, "holds nothing to share"),
        ({"eyes.onnx": b"no model"}, {}, "eyes.onnx"),
        ({"meta/info.json": b"[]"}, {}, "holds nothing to share"),
        ({"manifest.json": b"{}"}, {}, "is not the manifest of a data set of this package"),
        ({"meta/info.json": b'{"codebase_version": "3", "features": {}, "fps": 10}'}, {}, "holds a LeRobot data set"),
        ({"notes.md": b"12345"}, {"notes.md": b"123456789"}, "me/evil"),
    ],
)  # fmt: skip
def test_what_is_not_a_model_or_data_set_is_not_pulled(hub, tmp_path, capsys, files, lies, message):
    hub.repos["model me/evil"] = repo = Repo(private=False)
    repo.add(files)
    hub.lies |= lies
    assert message in said_of(capsys, "hub", "pull", "me/evil", tmp_path / "in" / "new")
    assert not (tmp_path / "in" / "new").exists()
    assert not any(each.suffix in (".py", ".pt") for each in tmp_path.rglob("*"))


def test_what_cannot_be_reached_or_is_too_large_is_one_sentence(hub, reader, tmp_path, capsys, monkeypatch):
    main(["hub", "push", str(reader), "me/eyes"])
    new, full = tmp_path / "new", tmp_path
    for words, expected in (
        (["pull", "me/eyes", full], "is not empty; give a new folder"),
        (["pull", "me/nothing", new], "me/nothing: is not at http://127.0.0.1"),
        (["pull", "me/eyes", new, "--revision", "v7"], "has no such revision"),
        (["pull", "me/eyes", new, "--max-gb", "1e-6"], "more than 1e-06 GB; allow more with --max-gb"),
        (["pull", "a/b/c", new], "'a/b/c' is no name on the Hub; write USER/NAME"),
        (["push", reader, "datasets/me/eyes"], "holds a reasoner, and datasets/me/eyes names a data set"),
        (["push", tmp_path / "nowhere", "me/eyes"], "there is no such folder"),
    ):
        assert expected in said_of(capsys, "hub", *words)
    monkeypatch.setenv("HF_TOKEN", "hf_wrong")
    assert "log in with `hf auth login` or set HF_TOKEN" in said_of(capsys, "hub", "push", reader, "me/eyes")
    monkeypatch.delenv("HF_TOKEN")
    assert "log in with `hf auth login` or set HF_TOKEN" in said_of(capsys, "hub", "push", reader, "me/eyes")
    monkeypatch.setenv("HF_ENDPOINT", "http://203.0.113.1")
    assert "give an https address" in said_of(capsys, "hub", "push", reader, "me/eyes")
    monkeypatch.setenv("HF_ENDPOINT", "https://[::1")
    assert "is no address" in said_of(capsys, "hub", "push", reader, "me/eyes")
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    assert "cannot be reached" in said_of(capsys, "hub", "pull", "me/eyes", new)
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert "cognitivedrone[hub]" in said_of(capsys, "hub", "pull", "me/eyes", new)
    assert not new.exists()


@pytest.mark.parametrize("sha", ["/tmp/elsewhere", "../..", "main", "0" * 39, "", "A" * 40])  # noqa: S108
def test_a_commit_that_is_no_commit_is_not_used_as_a_path(hub, tmp_path, capsys, sha):
    hub.repos["model me/evil"] = repo = Repo(private=False)
    repo.commits[sha] = {"recipe.json": b"{}"}
    assert "expected 40 hexadecimal digits" in said_of(capsys, "hub", "pull", "me/evil", tmp_path / "in" / "new")
    assert not list(tmp_path.iterdir())


def test_a_download_that_is_larger_than_listed_ends_while_it_arrives(hub, tmp_path, capsys):
    hub.repos["model me/evil"] = repo = Repo(private=False)
    repo.add({"eyes.onnx": b"small"})
    hub.lies["eyes.onnx"] = bytes(60_000_000)
    said = said_of(capsys, "hub", "pull", "me/evil", tmp_path / "new")
    assert "me/evil: " in said
    assert sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) < 40_000_000


def test_an_empty_endpoint_is_the_public_hub(monkeypatch):
    monkeypatch.setenv("HF_ENDPOINT", "")
    assert _api()[1] == "https://huggingface.co"


def test_an_upload_that_breaks_off_is_one_sentence(hub, reader, capsys):
    hub.broken = True
    assert "broke off" in said_of(capsys, "hub", "push", reader, "me/eyes")


def test_a_folder_with_links_or_code_is_not_pushed(store, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(store, folder)
    (folder / "extra.py").write_text("")
    with pytest.raises(HubError, match="may hold code"):
        contents_of(folder)
    (folder / "extra.py").unlink()
    (folder / "key.json").symlink_to("/etc/hostname")
    with pytest.raises(HubError, match="links are not shared"):
        contents_of(folder)


def test_names_of_files_that_are_shared():
    check_names(["SHA256SUMS", "data/chunk-000/file-000.parquet", "a/1.0.0/a-train.tfrecord-00000-of-00001"])


def test_the_packaged_models_are_of_known_kinds():
    folder = Path(str(resources.files("cognitivedrone.models") / "weights"))
    shared = contents_of(folder / "small")
    assert shared.kind == "policy and reasoner"
    assert set(shared.files) == MODELS - {"text_encoder.onnx", "word_pieces.onnx"} | {"model.onnx"}
    assert kind_of(folder / "race") == ("model", "policy")
    for path in folder.glob("*.onnx"):  # that all of them share
        _LOADERS[path.name](path)
