"""A chat server that wants other fields, more time, another address: it is obeyed, and learned from once."""

import json
import warnings

import numpy as np
import pytest
from chat_server import GOOD, Script, chat, serving

from cognitivedrone.errors import PolicyError, ReasonerError
from cognitivedrone.reasoners import make_reasoner

FRAME = np.zeros((256, 256, 3), np.uint8)
pytestmark = pytest.mark.usefixtures("no_vlm_settings")


def error(text: str) -> bytes:
    return json.dumps({"error": {"message": text, "type": "invalid_request_error"}}).encode()


class Refusing(Script):  # type: ignore[misc]  # the support module has no types
    """Refuses each of these fields with a status and words, one at a time, as servers do."""

    def __init__(self, **refused: tuple[int, str]) -> None:
        super().__init__()
        self.refused = refused
        self.behave = self._answer

    def _answer(self, handler) -> None:
        for name, (status, words) in self.refused.items():
            if name in self.bodies[-1]:
                return handler.answer(status, error(words))
        return handler.answer(200, chat(GOOD))


@pytest.mark.parametrize(
    "refused",
    [
        {"max_tokens": (400, "Unsupported parameter: 'max_tokens'. Use 'max_completion_tokens' instead.")},
        {"temperature": (400, "Unsupported value: 'temperature' does not support 0 with this model.")},
        {"response_format": (500, "failed to parse grammar")},
        {"response_format": (422, "json_schema is not supported"), "temperature": (400, "temperature must be 1"),
         "max_tokens": (400, "please use max_completion_tokens")},
    ],
)  # fmt: skip
def test_a_field_that_is_refused_is_learned_once_and_said_once(refused):
    script = Refusing(**refused)
    with serving(script) as url:
        reasoner = make_reasoner(f"vlm:{url},model=eye-7b,timeout=60")
        with pytest.warns(RuntimeWarning, match="does not take") as said:
            assert reasoner.refine(FRAME, "the dog").directive
        for _ in range(4):
            assert reasoner.refine(FRAME, "the dog").directive
        reasoner.close()
    assert len(said) == 1
    assert len(script.bodies) == 5 + len(refused)
    assert all(name not in script.bodies[-1] for name in refused)
    assert ("max_completion_tokens" in script.bodies[-1]) == ("max_tokens" in refused)


def test_a_server_that_says_when_to_come_again_is_obeyed_within_a_limit(monkeypatch):
    waits = []
    monkeypatch.setattr("cognitivedrone.reasoners.chat.time.sleep", waits.append)
    script = Script(replies=[(429, b"slow down")] * 4 + [(200, chat(GOOD))], headers={"Retry-After": "2"})
    with serving(script) as url:
        reasoner = make_reasoner(f"vlm:{url},model=eye-7b,timeout=60,retry=10")
        assert reasoner.refine(FRAME, "the dog").directive
        assert waits == [2.0] * 4
        script.replies = [(429, b"slow down")]
        with pytest.warns(RuntimeWarning), pytest.raises(ReasonerError, match="429"):
            reasoner.refine(FRAME, "the dog")
        assert len(waits) == 4 + 5
        reasoner.close()


@pytest.mark.parametrize(
    ("status", "before", "advice"),
    [
        (200, "", "the model is overloaded"),
        (400, "This model cannot read your messages. " * 4, "use a model with vision, such as eye-7b-vision"),
    ],
)
def test_an_error_is_no_answer_also_with_status_200_and_the_advice_at_its_end_is_quoted(status, before, advice):
    with serving(Script(replies=[(status, error(before + advice))])) as url:
        reasoner = make_reasoner(f"vlm:{url},model=eye-7b,timeout=60")
        with pytest.warns(RuntimeWarning), pytest.raises(ReasonerError, match=advice) as caught:
            reasoner.refine(FRAME, "the dog")
        reasoner.close()
    assert caught.value.kind == "http"


def test_an_address_without_v1_is_told_before_take_off():
    script = Script(models=(404, b""), replies=[(404, b"")])
    with serving(script) as url:
        reasoner = make_reasoner(f"vlm:{url.removesuffix('/v1')},model=eye-7b")
        with pytest.raises(PolicyError, match=rf"vlm:{url},model=eye-7b"):
            reasoner.check()
        reasoner.close()


def test_fields_of_ones_own_are_sent(tmp_path):
    (tmp_path / "extra.json").write_text('{"top_p": 0.9, "temperature": null}')
    script = Script()
    with serving(script) as url:
        reasoner = make_reasoner(f"vlm:{url},model=eye-7b,timeout=60,extra={tmp_path / 'extra.json'}")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            reasoner.refine(FRAME, "the dog")
        reasoner.close()
    assert script.bodies[0]["top_p"] == 0.9
    assert "temperature" not in script.bodies[0]
