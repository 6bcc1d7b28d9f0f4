"""Replies as vision-language models write them, and what each is to be read as.

The expectations are written down by hand: "SCS" for size, color and shape by their first letters ("-" where the reply
leaves one open: "bgt" is big green triangle), or the kind of fault.
"""

import json
from itertools import pairwise, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.errors import ReasonerError
from cognitivedrone.reasoners.reply import MAX_REPLY, read_reply
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

NAMES = ({"b": "big", "s": "small"}, {"r": "red", "g": "green", "b": "blue"})
SHAPE_NAMES = {"r": "round", "s": "square", "t": "triangle"}

REPLIES = {
    # a directive and nothing else
    "Fly through the small red round gate": "srr",
    "fly to the large blue circular gate": "bbr",
    "**Green round gate**": "-gr",
    "`small red triangle gate`": "srt",
    "Fly through the round gate": "--r",
    "the gate that is green and round": "-gr",
    "<think>The red gate? No, the blue one.</think>Fly through the green round gate": "-gr",
    # sentences that say more, or nothing of a gate
    "Not the red gate but the green gate": "garbage",
    "fly through the red gate or the blue gate": "garbage",
    "The red gate shows a cat. The green gate shows a dog.": "garbage",
    "The gate with a red frame": "garbage",
    "The answer is red.": "garbage",
    "I'm sorry, I can't help with that.": "garbage",
    "I cannot tell which gate is meant.": "garbage",
    "Fly through the yellow gate": "garbage",
    "red gate\ngreen square gate": "garbage",
    "": "garbage",
    "   \n ": "garbage",
    "\x00\x01\x02": "garbage",
    "的的的的": "garbage",
    "<html><body>502 Bad Gateway</body></html>": "garbage",
    "r" * (MAX_REPLY + 1): "too_long",
    # the schema, and what stands around it
    '{"size": "big", "color": "red", "shape": "round"}': "brr",
    '```json\n{"size": "big",\n "color": "red",\n "shape": "round"\n}\n```': "brr",
    'Sure! Here it is:\n{"size": "big", "color": "blue", "shape": "square"}\nFly safely.': "bbs",
    '{"Size": "Big", "Color": "RED", "Shape": "Round"}': "brr",
    '{"size": "little", "color": "green gate", "shape": "triangular"}': "sgt",
    '{"gate": {"size": "big", "color": "red", "shape": "round"}}': "brr",
    '[{"size": "big", "color": "red", "shape": "round"}]': "brr",
    '{"color": "green"}': "-g-",
    '{"size": null, "color": "green", "shape": null}': "-g-",
    '{"size": "unknown", "color": "green", "shape": "round"}': "-gr",
    'The red gate shows a cat. {"size": "small", "color": "green", "shape": "square"}': "sgs",
    '<think>{"color": "red"}</think>{"size": "big", "color": "blue", "shape": "round"}': "bbr",
    '{"size": "big", "color": "unknown", "shape": "round"}': "unsure",
    '{"size": "big", "color": null, "shape": null}': "unsure",
    '{"color": "red", "gate": 4}': "no_such_gate",
    '{"size": "big", "color": "yellow", "shape": "round"}': "schema",
    '{"size": "medium", "color": "red", "shape": "round"}': "schema",
    '{"size": "big", "color": "red|green|blue", "shape": "round"}': "schema",
    '{"size": "red", "color": "big", "shape": "round"}': "schema",
    '{"color": 3, "shape": "round"}': "schema",
    '[{"color": "red", "shape": "round"}, {"color": "blue", "shape": "square"}]': "schema",
    '{"left": {"color": "red"}, "right": {"color": "blue"}}': "schema",
    '{"gate": 2}': "garbage",
    '{"error": {"code": 7}}': "garbage",
    '{"size": "big", "color": "red", "shape": "round"': "garbage",
    "{'size': 'big', 'color': 'red', 'shape': 'round'}": "garbage",
    "Size: small\nColor: red\nShape: triangle": "garbage",
}


@pytest.mark.parametrize(("reply", "wanted"), REPLIES.items())
def test_recorded_replies(reply, wanted):
    if len(wanted) == 3:
        size, color, shape = tuple(wanted)
        parts = [NAMES[0].get(size), NAMES[1].get(color), SHAPE_NAMES.get(shape)]
        assert read_reply(reply).directive == " ".join(["Fly through the", *filter(None, parts), "gate"])
        return
    with pytest.raises(ReasonerError) as caught:
        read_reply(reply)
    assert caught.value.kind == wanted


@pytest.mark.parametrize(("size", "color", "shape"), list(product(SIZES, COLORS, SHAPES)))
def test_the_words_are_those_of_directives(size, color, shape):
    gate = Gate(size, shape, color)
    reply = json.dumps({"size": size, "color": color, "shape": shape})
    assert read_reply(reply).directive == write_directive(gate)
    assert read_reply(write_directive(gate)).directive == write_directive(gate)


@pytest.mark.parametrize(("value", "gate"), [("1", 0), ("3", 2), ("null", None), ('"the one"', None)])
def test_the_gates_place(value, gate):
    assert read_reply(f'{{"color": "red", "gate": {value}}}').gate == gate


@pytest.mark.parametrize(("value", "confidence"), [("0.25", 0.25), ("1", 1.0), ("900", 1.0), ('"high"', 1.0)])
def test_confidence_of_the_reply(value, confidence):
    reply = f'{{"size": "big", "color": "red", "shape": "round", "confidence": {value}}}'
    assert read_reply(reply).confidence == confidence


def test_less_said_is_less_sure():
    ladder = ["Fly through the big red round gate", "the red round gate", "the red gate"]
    confidences = [read_reply(reply).confidence for reply in ladder]
    assert confidences[0] == 1.0
    assert all(a > b > 0 for a, b in pairwise(confidences))


WORDS = sorted({word for reply in REPLIES if len(reply) < 200 for word in reply.split()})


@settings(max_examples=150)
@given(st.lists(st.sampled_from(WORDS) | st.text(max_size=8), max_size=30).map(" ".join))
def test_whatever_comes_is_a_gate_or_a_fault(text):
    try:
        guidance = read_reply(text)
    except ReasonerError:
        return
    assert 0 <= guidance.confidence <= 1
    assert guidance.gate in (None, 0, 1, 2)
    assert guidance.directive.startswith("Fly through the ")
    assert guidance.directive != "Fly through the gate"


@pytest.mark.parametrize("piece", ["{", "[", '{"color":', "'color': \"", "red gate ", "with ", "not ", "a: ", "(", "9"])
def test_long_nonsense_is_read_in_no_time(piece):
    with pytest.raises(ReasonerError) as caught:
        read_reply((piece * MAX_REPLY)[:MAX_REPLY])
    assert caught.value.kind in ("garbage", "schema", "unsure")
