"""Replies in the styles of thinking models, cut off or whole: none may steer to a gate that it does not name.

The right gate is the small blue square one, whatever else the model considers. What a server says beside the text comes
from a real HTTP server.
"""

import numpy as np
import pytest
from chat_server import Script, chat, serving

from cognitivedrone.errors import ReasonerError
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.prompt import load_prompt
from cognitivedrone.reasoners.reply import read_reply

FRAME = np.zeros((256, 256, 3), np.uint8)
ANSWER = '{"size": "small", "color": "blue", "shape": "square"}'
WRONG = '{"size": "big", "color": "red", "shape": "round"}'
RIGHT = {"Fly through the small blue square gate", "Fly through the blue square gate", "Fly through the blue gate"}
FORM = next(line for line in load_prompt().splitlines() if line.startswith("{"))
SEEN = "The first gate is a big red round gate, its panel shows a cat."
LONGER = f"Got it, let's look. {SEEN} The second gate is a small green triangle"

REPLIES = {
    # Qwen3-VL, thinking: the chat template opens the thinking, so a reply that is cut off has no mark at all
    "qwen cut off without a mark": (LONGER, "length", "unfinished"),
    "qwen cut off at the end of a sentence": (f"Got it. {SEEN} So it is the red gate.", "length", "unfinished"),
    "qwen whole": (f"{SEEN} The owl is on the third.\n</think>\n\n{ANSWER}", "stop", "right"),
    # DeepSeek, MiMo-VL, Skywork
    "deepseek unclosed": (f"<think>\n{SEEN} The answer is the red gate.", "length", "unfinished"),
    "deepseek unclosed, but said to be finished": (f"<think>\n{SEEN} Fly through the red gate.", "stop", "unfinished"),
    "deepseek thinks and says nothing": (f"<think>{WRONG}</think>", "stop", "unfinished"),
    "deepseek thinks twice": (f"<think>Red?</think> Hmm. <think>{WRONG}", None, "unfinished"),
    "deepseek whole": (f"<think>{SEEN} {WRONG}</think>\n```json\n{ANSWER}\n```", "stop", "right"),
    # GLM-4.1V, thinking
    "glm in a box": (f"<think>{SEEN}</think><answer><|begin_of_box|>{ANSWER}<|end_of_box|></answer>", "stop", "right"),
    "glm cut off in its answer": (f'<think>{SEEN}</think><answer>{{"size": "big", "color": "red"', "length",
                                  "unfinished"),
    "glm cut off, unsaid": ('<think>x</think><answer>{"size": "big", "color": "red"', None, "garbage"),
    # Kimi-VL
    "kimi unclosed": (f"◁think▷{SEEN} So the red gate is correct.", "stop", "unfinished"),
    "kimi whole": (f"◁think▷{SEEN} {WRONG}◁/think▷The small blue square gate.", "stop", "right"),
    # Magistral
    "magistral unclosed": (f"[THINK]{SEEN} Fly through the red gate.", None, "unfinished"),
    "magistral whole": (f"[THINK]{WRONG}[/THINK]{ANSWER}", "stop", "right"),
    # gpt-oss, without a parser
    "gpt-oss analysis alone": (f"<|channel|>analysis<|message|>{SEEN} So fly through the red gate.", "stop",
                               "unfinished"),
    "gpt-oss whole": (f"<|channel|>analysis<|message|>{WRONG}<|end|><|start|>assistant<|channel|>final<|message|>"
                      f"{ANSWER}<|return|>", "stop", "right"),
    # Gemma, Seed, EXAONE
    "seed unclosed": (f"<seed:think>{SEEN} The red gate it is.", "stop", "unfinished"),
    "exaone whole": (f"<thought>\n{WRONG}\n</thought>\n{ANSWER}", "stop", "right"),
    # Llama with steps, as LLaVA-CoT
    "steps": (f"<SUMMARY>Find the owl.</SUMMARY><REASONING>{SEEN}</REASONING><CONCLUSION>{ANSWER}</CONCLUSION>", "stop",
              "right"),
    "steps cut off": (f"<SUMMARY>Find it.</SUMMARY><REASONING>{SEEN} So the red", "length", "unfinished"),
    # QVQ: no marks, a boxed end
    "qvq whole": (f"{SEEN} So the owl is on the third.\n\n**Final Answer**\n\n\\boxed{{\\text{{blue square gate}}}}",
                  "stop", "right"),
    "qvq cut off": (f"So I need the owl. {SEEN} Wait, maybe the red", None, "garbage"),
    # forms that are not filled in, hedges, contradictions
    "the form of the prompt": (FORM, "stop", "garbage"),
    "the form, quoted": (f"I must answer as {FORM}", "stop", "fault"),
    "the form, then the answer": (f"The form is {FORM}\nAnswer: {ANSWER}", "stop", "right"),
    "the form with bars": ('{"size": "big|small", "color": "red|green|blue", "shape": "round"}', "stop", "schema"),
    "a hedge in JSON": ('{"size": "small", "color": "red" or "blue", "shape": "round"}', "stop", "garbage"),
    "a list of two": ('{"size": "small", "color": ["red", "blue"], "shape": "round"}', "stop", "schema"),
    "two answers": (f"{WRONG}\n{ANSWER}", "stop", "schema"),
    "two options": (f"Option A: {WRONG}\nOption B: {ANSWER}", "stop", "schema"),
    "one key twice": ('{"color": "red", "shape": "square", "color": "blue"}', "stop", "garbage"),
    "all gates in lines": ("1. Color: red, Shape: round\n2. Color: green, Shape: square\n", "stop", "fault"),
    "JSON and then another": (f"{WRONG} Wait, the correct gate is the blue one.", "stop", "unsure"),
    # forms that say one thing
    "lists of one": ('{"size": ["small"], "color": ["blue"], "shape": ["square"]}', "stop", "right"),
    "no reason given, whole JSON": (ANSWER, None, "right"),
    "no reason given, whole sentence": ("Fly through the small blue square gate.", None, "right"),
    "no reason given, a directive": ("Fly through the small blue square gate", None, "right"),
    "a call of a tool": (ANSWER, "tool_calls", "unfinished"),
    "filtered": (WRONG, "content_filter", "refusal"),
    # other languages: the last one has an English word for another gate
    "German": ("Fliege durch das kleine blaue quadratische Tor.", "stop", "garbage"),
    "Chinese": ("穿过蓝色方形小门", "stop", "garbage"),
    "Spanish JSON": ('{"size": "pequeño", "color": "azul", "shape": "cuadrado"}', "stop", "schema"),
    # thinking aloud
    "a question": ("Is it the red gate?", "stop", "garbage"),
    "taken back": ("I would say the red one... no wait", "stop", "garbage"),
    "a condition": ("If the sum is 7, fly through the red gate; if it is 8, the blue gate.", "stop", "garbage"),
    "a condition after JSON": (f"{WRONG} if the cat is red", "stop", "unsure"),
    "it ends in the middle": ("So the answer is red or", "stop", "garbage"),
    "French": ("Passe par la porte bleue, pas par le triangle rouge", "stop", "garbage"),
}  # fmt: skip


def reply(content, finish_reason="stop", **message):
    body = chat(content, **message)
    return body.replace(b'"finish_reason": "stop"', f'"finish_reason": "{finish_reason}"'.encode())


@pytest.fixture
def asked(no_vlm_settings):
    """What the reasoner makes of replies, one after the other, and the server's script."""
    script, made = Script(), []

    def ask(*replies, more=""):
        script.replies = [(200, one) for one in replies]
        with serving(script) as url:
            made.append(make_reasoner(f"vlm:{url},model=eye-7b,timeout=60{more}"))
            return made[-1].refine(FRAME, "Fly through the gate with the owl").directive

    yield ask, script
    for reasoner in made:
        reasoner.close()


@pytest.mark.parametrize(("content", "finish_reason", "wanted"), REPLIES.values(), ids=REPLIES)
def test_a_reply_steers_to_the_gate_that_it_names_or_not_at_all(content, finish_reason, wanted):
    if wanted == "right":
        assert read_reply(content, finish_reason).directive in RIGHT
        return
    with pytest.raises(ReasonerError) as caught:
        read_reply(content, finish_reason)
    assert wanted in ("fault", caught.value.kind)
    if wanted == "unfinished":
        assert "tokens=N" in str(caught.value)
        assert "thinking=no" in str(caught.value)


@pytest.mark.filterwarnings("ignore:reasoner vlm:RuntimeWarning")
@pytest.mark.parametrize("field", ["reasoning", "reasoning_content", "thinking"])
@pytest.mark.parametrize("content", [None, ""])
def test_thinking_in_a_field_of_its_own_is_no_answer(asked, field, content):
    ask, _ = asked
    with pytest.raises(ReasonerError, match="holds the model's thinking, and no answer at the token limit") as caught:
        ask(reply(content, "length", **{field: f"{SEEN} Fly through the red gate."}))
    assert caught.value.kind == "unfinished"
    assert ask(reply(ANSWER, **{field: WRONG})) in RIGHT


def test_thinking_in_a_part_of_its_own_is_no_answer(asked):
    ask, _ = asked
    thinking = {"type": "thinking", "thinking": [{"type": "text", "text": WRONG}], "text": WRONG}
    assert ask(reply([thinking, {"type": "text", "text": ANSWER}])) in RIGHT
    with pytest.warns(RuntimeWarning), pytest.raises(ReasonerError, match="no answer"):
        ask(reply([thinking]))


@pytest.mark.parametrize("first", ["Fliege durch das blaue Tor.", "蓝色", '{"color": "azul", "shape": "cuadrado"}'])
def test_an_answer_that_cannot_be_read_is_asked_for_again_in_english(asked, first):
    ask, script = asked
    assert ask(reply(first), reply(ANSWER)) in RIGHT
    once, again = script.bodies
    assert again["messages"][:-2] == once["messages"]
    assert again["messages"][-2] == {"role": "assistant", "content": first}
    assert "in English" in again["messages"][-1]["content"]
    assert again["response_format"] == once["response_format"]


def test_a_reply_that_was_cut_off_is_not_asked_for_again(asked):
    ask, script = asked
    with pytest.warns(RuntimeWarning), pytest.raises(ReasonerError, match=r"tokens=N.*thinking=no"):
        ask(reply(LONGER, "length"))
    assert len(script.bodies) == 1


@pytest.mark.parametrize(
    ("more", "tokens", "template"),
    [("", 40, None), (",tokens=300", 300, None), (",thinking=no", 40, {"enable_thinking": False}),
     (",thinking=yes", 4096, {"enable_thinking": True}), (",thinking=yes,tokens=9", 9, {"enable_thinking": True})],
)  # fmt: skip
def test_the_options_for_thinking_are_sent(asked, more, tokens, template):
    ask, script = asked
    ask(reply(ANSWER), more=more)
    assert script.bodies[0]["max_tokens"] == tokens
    assert script.bodies[0].get("chat_template_kwargs") == template
    assert script.bodies[0]["response_format"]["json_schema"]["strict"] is True


@pytest.mark.parametrize("length", range(1, len(ANSWER)))
def test_no_beginning_of_an_answer_steers(length):
    try:
        directive = read_reply(ANSWER[:length]).directive
    except ReasonerError:
        return
    assert length >= len(ANSWER) - 1
    assert directive in RIGHT


def test_the_forms_number_of_tokens_is_checked():
    for reasoner in ("vlm:http://h/v1,model=x", "vlm-local:nowhere"):
        with pytest.raises(Exception, match=r"tokens=0; it must be from 1 to|tokens=99999; it must be from 1 to"):
            make_reasoner(f"{reasoner},tokens=99999")
