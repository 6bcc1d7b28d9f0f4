"""The VLM reasoner against a real HTTP server on loopback that answers as the chat API does, and as it should not."""

import base64
import io
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler
from typing import cast

import numpy as np
import pytest
from chat_server import GOOD, Script, chat, serving
from PIL import Image
from waiting import free_port

from cognitivedrone.errors import MissingExtra, PolicyError, ReasonerError
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.prompt import ANSWER_SCHEMA, load_prompt, write_prompt
from cognitivedrone.reasoners.vlm import Vlm
from cognitivedrone.types import Guidance

FRAME = np.random.default_rng(7).integers(0, 256, (256, 256, 3), dtype=np.uint8)
BIG_GREEN = Guidance("Fly through the big green triangle gate", None, 1.0)
KEY = "sk-a-secret-of-42"
INSTRUCTION = "Fly through the gate with the zebra"

pytestmark = pytest.mark.usefixtures("no_vlm_settings")


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def url(script) -> Iterator[str]:
    with serving(script) as address:
        yield address


@pytest.fixture
def make(url) -> Iterator[Callable[..., Vlm]]:
    made: list[Vlm] = []

    def build(more: str = "", where: str = url) -> Vlm:
        timeout = "" if "timeout" in more else ",timeout=60"
        made.append(cast(Vlm, make_reasoner(f"vlm:{where},model=eye-7b{timeout}{more}")))
        return made[-1]

    yield build
    for reasoner in made:
        reasoner.close()


def fault(reasoner: Vlm) -> ReasonerError:
    with pytest.warns(RuntimeWarning, match="the flight continues"), pytest.raises(ReasonerError) as caught:
        reasoner.refine(FRAME, INSTRUCTION)
    return caught.value


def test_what_is_asked_and_what_comes_back(script, make, monkeypatch):
    monkeypatch.setenv("COGNITIVEDRONE_VLM_KEY", KEY)
    assert make().refine(FRAME, INSTRUCTION) == BIG_GREEN
    assert script.paths == ["/v1/chat/completions"]
    assert script.keys == [f"Bearer {KEY}"]
    (body,) = script.bodies
    assert body["model"] == "eye-7b"
    assert body["temperature"] == 0
    assert body["max_tokens"] <= 40
    assert body["response_format"]["json_schema"]["schema"] == ANSWER_SCHEMA
    picture, text = body["messages"][0]["content"]
    head, _, data = picture["image_url"]["url"].partition(",")
    assert head == "data:image/png;base64"
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))), FRAME)
    assert INSTRUCTION in text["text"]
    assert "{instruction}" not in text["text"]


def test_the_key_is_neither_shown_nor_repeated(script, make, monkeypatch):
    monkeypatch.setenv("COGNITIVEDRONE_VLM_KEY", KEY)
    script.replies = [(400, f'{{"error": "you said {KEY}"}}'.encode())]
    reasoner = make()
    error = fault(reasoner)
    assert KEY not in str(error) + repr(reasoner)
    assert "you said ***" in str(error)


def test_the_environment_fills_in(script, url, monkeypatch):
    monkeypatch.setenv("COGNITIVEDRONE_VLM_URL", url)
    monkeypatch.setenv("COGNITIVEDRONE_VLM_MODEL", "eye-3b")
    reasoner = Vlm()
    reasoner.refine(FRAME, INSTRUCTION)
    reasoner.close()
    assert script.bodies[0]["model"] == "eye-3b"


def test_the_key_of_another_service_goes_nowhere_else(script, url, make, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    make().refine(FRAME, INSTRUCTION)
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    reasoner = make_reasoner("vlm:model=eye-7b")
    reasoner.refine(FRAME, INSTRUCTION)
    reasoner.close()
    assert script.keys == [None, f"Bearer {KEY}"]


def test_a_prompt_of_the_users(script, make, tmp_path):
    file = tmp_path / "my.txt"
    file.write_text('Do {instruction}; {instruction}! As {"color": "red"} or {0} {}')
    make(f",prompt={file}").refine(FRAME, "this {instruction}\nnow")
    text = script.bodies[0]["messages"][0]["content"][1]["text"]
    assert text == 'Do this {instruction} now; this {instruction} now! As {"color": "red"} or {0} {}'


def test_down(make):
    assert fault(make(where=f"http://127.0.0.1:{free_port()}/v1")).kind == "unreachable"


def test_slow(script, make):
    release = threading.Event()
    script.behave = lambda handler: release.wait(60) and None
    assert fault(make(",timeout=0.3")).kind == "timeout"  # while the server is still silent
    release.set()


def test_drop_by_drop(script, make):
    def drip(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Length", "10000")
        handler.end_headers()
        try:
            for _ in range(3000):
                handler.wfile.write(b" ")
                handler.wfile.flush()
                time.sleep(0.02)
        except OSError:
            handler.close_connection = True

    script.behave = drip  # for a minute
    assert fault(make(",timeout=0.3")).kind == "timeout"


@pytest.mark.parametrize(
    ("body", "kind"),
    [
        (b"<!DOCTYPE html><html><body>Bad gateway</body></html>", "garbage"),
        (chat(GOOD)[:60], "garbage"),
        (b"", "garbage"),
        (b"\xff\xfe\x00", "garbage"),
        (b"[" * 100_000, "garbage"),
        (b'{"detail": "welcome"}', "schema"),
        (b'{"choices": []}', "schema"),
        (b'{"choices": [{"message": null}]}', "schema"),
        (b"[1, 2]", "schema"),
        (chat(None), "schema"),
        (chat(None, refusal="I can't look at people."), "refusal"),
        (chat('{"size": "big", "color": "yellow", "shape": "round"}'), "schema"),
        (b" " * 10_000_000, "too_long"),
    ],
)
def test_responses_that_do_not_do(script, make, body, kind):
    script.replies = [(200, body)]
    assert fault(make()).kind == kind


@pytest.mark.parametrize("status", [429, 500, 503])
def test_busy_and_then_fine(script, make, status):
    script.replies = [(status, b"busy"), (200, chat(GOOD))]
    assert make().refine(FRAME, INSTRUCTION) == BIG_GREEN
    assert len(script.bodies) == 2


def test_busy_for_good(script, make):
    script.replies = [(429, b"slow down")]
    error = fault(make())
    assert error.kind == "http"
    assert "429" in str(error)
    assert len(script.bodies) == 3


@pytest.mark.parametrize(
    ("status", "expected"), [(400, "image too"), (401, "COGNITIVEDRONE_VLM_KEY"), (404, "eye-7b"), (302, "redirect")]
)
def test_errors_that_do_not_go_away_are_not_tried_again(script, make, status, expected):
    script.headers = {"Location": "/elsewhere"} if status == 302 else {}
    script.replies = [(status, b'{"error": "image too large"}')]
    error = fault(make())
    assert error.kind == "http"
    assert expected in str(error)
    assert len(script.bodies) == 1


def test_a_failure_is_reported_once_for_each_kind(script, make):
    reasoner = make()
    script.replies = [(200, b"<html>")]
    assert fault(reasoner).kind == "garbage"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ReasonerError, match="not JSON"):
            reasoner.refine(FRAME, INSTRUCTION)
    script.replies = [(404, b"")]
    assert fault(reasoner).kind == "http"


def test_an_instruction_that_is_too_long_is_not_sent(script, make):
    reasoner = make()
    with pytest.warns(RuntimeWarning), pytest.raises(ReasonerError) as caught:
        reasoner.refine(FRAME, "fly " * 300)
    assert caught.value.kind == "too_long"
    assert script.bodies == []


def test_the_check_passes_a_server_that_has_the_model(script, make, monkeypatch):
    monkeypatch.setenv("COGNITIVEDRONE_VLM_KEY", KEY)
    make().check()
    assert script.paths == ["/v1/models"]
    assert script.keys == [f"Bearer {KEY}"]


def test_the_check_passes_a_server_without_a_list(script, make):
    script.models = (404, b"")
    make().check()


def test_the_check_names_the_models_that_there_are(url):
    reasoner = make_reasoner(f"vlm:{url},model=eye-8b")
    with pytest.raises(PolicyError, match=r"did you mean 'eye-.b' or 'eye-.b'"):
        reasoner.check()
    reasoner.close()


@pytest.mark.parametrize(
    ("key", "answer", "expected"),
    [
        ("wrong", (401, b'{"error": "bad key"}'), "rejects the key"),
        ("", (401, b'{"error": "bad key"}'), "requires a key"),
        ("", (500, b"out of memory"), r"500.*out of memory"),
    ],
)
def test_the_check_knows_a_wrong_key_and_a_server_in_trouble(script, make, monkeypatch, key, answer, expected):
    monkeypatch.setenv("COGNITIVEDRONE_VLM_KEY", key)
    script.models = answer
    with pytest.raises(PolicyError, match=expected):
        make().check()


def test_the_check_says_how_to_start_a_server(make):
    with pytest.raises(PolicyError, match="vllm serve eye-7b"):
        make(where=f"http://127.0.0.1:{free_port()}/v1").check()


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        (None, "needs a model"),
        ("http://127.0.0.1:1/v1", "needs a model"),
        ("localhost:8000,model=x", "not a base URL"),
        ("ftp://host/v1,model=x", "not a base URL"),
        ("http://host:port/v1,model=x", "not a base URL"),
        ("http://me:secret@host/v1,model=x", "COGNITIVEDRONE_VLM_KEY"),
        ("http://host/v1,model=x,timeout=0", "timeout=0; it must be"),
        ("http://host/v1,model=x,timeout=nan", "timeout=nan; it must be"),
        ("http://host/v1,model=x,key=y", "no option 'key'"),
        ("http://host/v1,model=x,prompt=/nowhere/p.txt", "/nowhere/p.txt"),
    ],
)
def test_arguments_that_do_not_do(argument, expected):
    with pytest.raises(PolicyError, match=expected):
        make_reasoner("vlm" if argument is None else f"vlm:{argument}")


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"no place", r"lacks \{instruction\}"), (b"\xff{instruction}", "UTF-8"), (b"{instruction}" * 2000, "20,000")],
)
def test_prompt_files_that_do_not_do(tmp_path, content, expected):
    file = tmp_path / "p.txt"
    file.write_bytes(content)
    with pytest.raises(PolicyError, match=expected):
        load_prompt(file)


def test_the_prompt_of_the_package_asks_for_what_the_schema_has():
    text = write_prompt(load_prompt(), INSTRUCTION)
    for name, rule in ANSWER_SCHEMA["properties"].items():
        assert f'"{name}"' in text
        assert all(f'"{value}"' in text for value in rule["enum"])


def test_missing_httpx_names_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "httpx", None)
    with pytest.raises(MissingExtra, match=r"httpx.*cognitivedrone\[vlm\]"):
        make_reasoner("vlm:http://host/v1,model=x")
