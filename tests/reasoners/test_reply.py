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

SENTENCES = {
    # plain directives
    "Fly through the small red round gate": "srr",
    "Fly through red circle gate with number 4": "-rr",
    "The correct gate is the small blue square one.": "sbs",
    "Fly through the big triangle red gate with 9": "brt",
    "fly to the large blue circular gate": "bbr",
    "Green": "-g-",
    "The answer is red.": "-r-",
    "**Green round gate**": "-gr",
    "`small red triangle gate`": "srt",
    "> Go through the blue ring": "-br",
    "Fly through the big, red, round gate.": "brr",
    "Fly through the round gate": "--r",
    "Fly through the triangular gate on the left.": "--t",
    "Choose the green-colored, triangle-shaped gate": "-gt",
    "Gate 2 (small, red, triangle)": "srt",
    "The target is the large green square gate on the right": "bgs",
    "Answer: the blue triangle gate.": "-bt",
    "Please fly through the large red rectangular gate.": "brs",
    "Drone should enter the blue square gate below the panel with the apple": "-bs",
    "Gate with red color and round shape": "-rr",
    "The gate with a red frame": "-r-",
    # the gate described after it is named
    "the gate that is green and round": "-gr",
    "The gate which is big, blue and triangular": "bbt",
    "The correct gate is green and its shape is a triangle.": "-gt",
    "The correct gate is blue.": "-b-",
    "The drone should fly through the round gate, which is red.": "-rr",
    "The target gate is red, square and big.": "brs",
    # what panels show is not of the gate
    "triangle gate with the red hat": "--t",
    "Fly through the small gate with the blue circle": "s--",
    "Fly through the green gate labeled with a red apple": "-g-",
    "The person with the red hat is above the small green triangular gate.": "sgt",
    "The panel with the green apple is above the blue square gate.": "-bs",
    "Go to the round gate under the picture of a green tree": "--r",
    "7 x 8 = 56. The panel with 56 is above the red round gate.": "-rr",
    # choices
    "Not the red one but the green one": "-g-",
    "Fly through the green gate, not the red one.": "-g-",
    "Fly through the blue gate instead of the red one": "-b-",
    "Fly through the blue gate rather than the green gate.": "-b-",
    "The red gate is wrong. Fly through the blue gate.": "-b-",
    "The red gate is not correct. The green gate is correct.": "-g-",
    "Avoid the red gate and the blue gate, go through the green square.": "-gs",
    "Sorry for the confusion, the correct gate is the big red round one.": "brr",
    "I'm not sure, but I think it is the green gate": "-g-",
    "I cannot see the label clearly, but it is probably the blue triangle gate.": "-bt",
    "fly through the red gate or the blue gate": "unsure",
    "It is either the red or the green gate": "unsure",
    "The correct gate is the green one because the red gate shows a cat.": "-g-",
    "Since the red gate shows a cat, the answer is the blue gate": "-b-",
    "Neither the red nor the green gate, so blue.": "-b-",
    # chains of thought
    "The red gate shows a cat, the green gate shows a dog. So the correct gate is the green round one.": "-gr",
    "The red gate shows 3, the green gate shows 9, so fly through the green gate": "-g-",
    "The sum is 6+7=13. The big red round gate shows 12. The small blue square gate shows 13."
    " Therefore the drone must fly through the blue gate.": "sbs",
    "Red gate: cat. Green gate: dog. Blue gate: owl.\nAn owl flies at night.\nAnswer: blue gate": "-b-",
    "First I thought of the red gate. Then I saw that the answer is the green gate.": "-g-",
    "Let me think. A zebra has stripes.\n\nSmall red triangle gate": "srt",
    "<think>The red gate? No, the blue one.</think>Fly through the green round gate": "-gr",
    "1. The red gate has an apple.\n2. The green gate has a car.\n3. The blue gate has a key.\n"
    "A key opens doors, so the answer is the blue gate.": "-b-",
    "There are three gates. The green gate is in the middle. The answer is the green gate. Have a safe flight!": "-g-",
    "The green gate shows a lion.": "-g-",
    "The red gate shows a cat. The green gate shows a dog.": "unsure",
    "Fly to the red gate. Wait, the lion is on the right. Fly to the blue gate.": "-b-",
    # refusals
    "I'm sorry, I can't help with that.": "refusal",
    "I'm sorry, but I can't assist with this request.": "refusal",
    "I’m sorry, but I can’t identify people in images.": "refusal",
    "I cannot help you fly a drone through the red gate.": "refusal",
    "As an AI language model, I do not fly drones.": "refusal",
    "I apologize.": "refusal",
    "Sorry!": "refusal",
    "I can't recognize individuals based on their appearance.": "refusal",
    # doubts
    "unknown": "unsure",
    "Unknown.": "unsure",
    "None of the gates": "unsure",
    "N/A": "unsure",
    "I cannot tell which gate is meant.": "unsure",
    "It cannot be determined from the image": "unsure",
    "I'm not sure.": "unsure",
    "I am not sure whether it is the red or the green gate": "unsure",
    "The red gate shows a cat. The green gate shows a dog. I cannot tell which one.": "unsure",
    "There is no matching gate.": "unsure",
    "The label is not visible.": "unsure",
    "Not enough information": "unsure",
    "I'm sorry, but I can't determine the right gate": "unsure",
    # gates that there are not
    "Fly through the yellow gate": "no_such_gate",
    "Fly through the hexagonal gate": "no_such_gate",
    "Fly through the big purple round gate.": "no_such_gate",
    "The correct gate is the white one.": "no_such_gate",
    "The answer is the oval gate": "no_such_gate",
    "Fly through the red pentagon gate": "no_such_gate",
    # noise
    "": "garbage",
    "   \n ": "garbage",
    "asdkj 3k2j": "garbage",
    "42": "garbage",
    "The quick fox jumps over the lazy dog": "garbage",
    "<html><body>502 Bad Gateway</body></html>": "garbage",
    "<!DOCTYPE html>\n<title>Sign in</title> Fly through the red gate": "garbage",
    "Hello! How can I be of use today?": "garbage",
    "The drone flies forward.": "garbage",
    "\x00\x01\x02": "garbage",
    "的的的的": "garbage",
    "Fly through the gate with the zebra": "garbage",
    "r" * (MAX_REPLY + 1): "too_long",
    "The red gate. " * 1000: "too_long",
}

JSON_REPLIES = {
    '{"size": "big", "color": "red", "shape": "round"}': "brr",
    '```json\n{"size": "big", "color": "red", "shape": "round"}\n```': "brr",
    '```\n{"size": "big", "color": "red", "shape": "round"}\n```': "brr",
    'Sure! Here it is:\n{"size": "big", "color": "blue", "shape": "square"}\nFly safely.': "bbs",
    "{'size': 'big', 'color': 'red', 'shape': 'round'}": "brr",
    '{"size": "big", "color": "red", "shape": "round",}': "brr",
    "{size: big, color: red, shape: round}": "brr",
    "color: green, shape: round, size: big": "bgr",
    "Size: small\nColor: red\nShape: triangle": "srt",
    "{“size”: “big”, “color”: “red”, “shape”: “round”}": "brr",
    '{"Size": "Big", "Color": "RED", "Shape": "Round"}': "brr",
    '{"size": "large", "colour": "red", "shape": "circle"}': "brr",
    '{"size": "little", "color": "green gate", "shape": "triangular"}': "sgt",
    '{"gate": {"size": "big", "color": "red", "shape": "round"}}': "brr",
    '[{"size": "big", "color": "red", "shape": "round"}]': "brr",
    '{"size": "big", "color": "red", "shape": "round", "confidence": 0.': "brr",
    '{"size": "big", "color": "red", "shape": "round"': "brr",
    '{"size": "big", "color": "red", "shape": "rou': "unfinished",
    '{"size": "big", "color": "red",': "unfinished",
    '{"color": "green"}': "-g-",
    '{"size": null, "color": "green", "shape": null}': "-g-",
    '{"size": "unknown", "color": "green", "shape": "round"}': "-gr",
    '{"size": "big", "color": "red", "shape": "round"} Wait: {"size": "big", "color": "blue", "shape": "round"}': "bbr",
    'The red gate shows a cat. {"size": "small", "color": "green", "shape": "square"}': "sgs",
    '<think>{"color": "red"}</think>{"size": "big", "color": "blue", "shape": "round"}': "bbr",
    '{"size": "big",\n "color": "red",\n "shape": "round"\n}': "brr",
    '{"1": "cat", "2": "dog"} So the correct gate is the red round gate.': "-rr",
    '{"size": "big", "color": "unknown", "shape": "round"}': "unsure",
    '{"size": "unknown", "color": "unknown", "shape": "unknown"}': "unsure",
    '{"size": "big", "color": null, "shape": null}': "unsure",
    '{"color": "none"}': "unsure",
    '{"size": "big", "color": "yellow", "shape": "round"}': "no_such_gate",
    '{"size": "big", "color": "red", "shape": "hexagon"}': "no_such_gate",
    '{"color": "red", "gate": 4}': "no_such_gate",
    '{"size": "medium", "color": "red", "shape": "round"}': "schema",
    '{"size": "big", "color": "red|green|blue", "shape": "round"}': "schema",
    '{"color": 3, "shape": "round"}': "schema",
    '{"gate": 2}': "schema",
    '{"size": "big"}': "schema",
    "{}": "schema",
    "[]": "schema",
    '{"error": {"code": 7}}': "schema",
    '```json\n{"label": "cat"}\n```': "schema",
    '[{"color": "red", "shape": "round"}, {"color": "blue", "shape": "square"}]': "schema",
    '{"left": {"color": "red"}, "right": {"color": "blue"}}': "schema",
    '{"size": "b': "garbage",
    '{"size": "big", "col': "garbage",
    "{": "garbage",
}

FRAMES = (
    "Fly through the {} gate",
    "Go to the {} gate with number 7.",
    "The correct gate is the {} one.",
    "The label shows a lion, so the drone should fly through the {} gate.",
    "The red gate shows 4. The blue gate shows 5. The green gate shows 6. Therefore: fly to the {} gate!",
)


def expected(code: str) -> str:
    """The sentence for a code such as "br-"."""
    size, color, shape = tuple(code)
    parts = [NAMES[0].get(size), NAMES[1].get(color), SHAPE_NAMES.get(shape)]
    return " ".join(["Fly through the", *(part for part in parts if part), "gate"])


def check(reply: str, wanted: str) -> None:
    if len(wanted) == 3:
        assert read_reply(reply).directive == expected(wanted)
    else:
        with pytest.raises(ReasonerError) as caught:
            read_reply(reply)
        assert caught.value.kind == wanted


@pytest.mark.parametrize(("reply", "wanted"), [*SENTENCES.items(), *JSON_REPLIES.items()])
def test_recorded_replies(reply, wanted):
    check(reply, wanted)


@pytest.mark.parametrize("frame", FRAMES)
def test_every_gate_in_every_wording(frame):
    for (size, size_name), (color, color_name), (shape, shape_name) in product(
        (("b", "big"), ("b", "large"), ("s", "small")),
        (("r", "red"), ("g", "green"), ("b", "blue")),
        (("r", "round"), ("r", "circular"), ("s", "square"), ("t", "triangle"), ("t", "triangular")),
    ):
        for order in (f"{size_name} {color_name} {shape_name}", f"{color_name}, {shape_name} {size_name}"):
            check(frame.format(order), size + color + shape)


@pytest.mark.parametrize(("size", "color", "shape"), list(product(SIZES, COLORS, SHAPES)))
def test_the_words_are_those_of_directives(size, color, shape):
    gate = Gate(size, shape, color)
    reply = json.dumps({"size": size, "color": color, "shape": shape})
    assert read_reply(reply).directive == write_directive(gate)
    assert read_reply(write_directive(gate)).directive == write_directive(gate)


@pytest.mark.parametrize(
    ("value", "gate"),
    [("1", 0), ('"2"', 1), ("3", 2), ('"left"', 0), ('"right"', 2), ("null", None), ('"the one"', None)],
)
def test_the_gates_place(value, gate):
    assert read_reply(f'{{"color": "red", "gate": {value}}}').gate == gate


def test_a_sentence_gives_no_place():
    assert read_reply("Fly through the second gate, the red one, gate 2").gate is None


@pytest.mark.parametrize(
    ("reply", "confidence"),
    [
        ('{"size": "big", "color": "red", "shape": "round", "confidence": 0.25}', 0.25),
        ('{"size": "big", "color": "red", "shape": "round", "confidence": 1}', 1.0),
        ('{"size": "big", "color": "red", "shape": "round", "confidence": "90%"}', 0.9),
        ('{"size": "big", "color": "red", "shape": "round", "confidence": 85}', 0.85),
        ('{"size": "big", "color": "red", "shape": "round", "confidence": 900}', 1.0),
        ('{"size": "big", "color": "red", "shape": "round", "confidence": NaN}', 1.0),
        ("The red gate. Confidence: 0.7", 0.7),
        ("The red gate (confidence 70%)", 0.7),
    ],
)
def test_confidence_of_the_reply(reply, confidence):
    assert read_reply(reply).confidence == pytest.approx(confidence)


def test_less_said_is_less_sure():
    ladder = ["Fly through the big red round gate", "the red round gate", "the red gate", "not sure, but the red gate"]
    confidences = [read_reply(reply).confidence for reply in ladder]
    assert confidences[0] == 1.0
    assert all(a > b > 0 for a, b in pairwise(confidences))


WORDS = sorted({word for reply in (*SENTENCES, *JSON_REPLIES) if len(reply) < 200 for word in reply.split()})


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
    text = (piece * MAX_REPLY)[:MAX_REPLY]
    try:
        read_reply(text)
    except ReasonerError as error:
        assert error.kind in ("garbage", "schema", "unsure")  # noqa: PT017
