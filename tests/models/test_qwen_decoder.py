"""Qwen2.5-VL by our own loop: the same tokens as Transformers', in fewer passes. Tiny networks with random weights."""

from __future__ import annotations

import copy
from typing import Any

import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

from torch._dynamo.utils import counters  # noqa: E402

from cognitivedrone.models.openvla.weights import quantise  # noqa: E402
from cognitivedrone.models.qwen_decoder import Forms, QwenDecoder  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")
IMAGE, START, END = 297, 299, 2
GRID = (4, 6)


@pytest.fixture(scope="module")
def model() -> Any:
    text = {
        "hidden_size": 32, "intermediate_size": 48, "num_hidden_layers": 3, "num_attention_heads": 2,
        "num_key_value_heads": 1, "vocab_size": 300, "bos_token_id": 1, "eos_token_id": END,
        "rope_parameters": {"rope_type": "default", "rope_theta": 1e4, "mrope_section": [2, 3, 3]},
    }  # fmt: skip
    vision = {
        "depth": 2, "hidden_size": 32, "intermediate_size": 48, "num_heads": 2, "out_hidden_size": 32,
        "fullatt_block_indexes": [1],
    }  # fmt: skip
    tokens = {"image_token_id": IMAGE, "video_token_id": 298, "vision_start_token_id": START}
    torch.manual_seed(0)
    config = transformers.Qwen2_5_VLConfig(text_config=text, vision_config=vision, **tokens)
    made = transformers.AutoModelForImageTextToText.from_config(config, attn_implementation="sdpa")
    with torch.no_grad():  # so that the answers differ from each other
        made.lm_head.weight.normal_(std=1.0)
    return made.eval().requires_grad_(False)


def question(seed: int, before: int = 20, after: int = 30) -> dict[str, Any]:
    """A constant text, an image, and a question that depends on the seed."""
    constant = torch.arange(10, 10 + before)
    generator = torch.Generator().manual_seed(seed)
    words = torch.randint(10, 290, (after,), generator=generator)
    seen = torch.full((GRID[0] * GRID[1] // 4,), IMAGE)
    ids = torch.cat([constant, torch.tensor([START]), seen, words])[None]
    return {
        "input_ids": ids,
        "attention_mask": torch.ones_like(ids),
        "mm_token_type_ids": (ids == IMAGE).int(),
        "pixel_values": torch.randn(GRID[0] * GRID[1], 3 * 2 * 14 * 14, generator=generator),
        "image_grid_thw": torch.tensor([[1, *GRID]]),
    }


def generated(model: Any, inputs: dict[str, Any], most: int, forms: Forms | None = None) -> list[int]:
    begin = inputs["input_ids"].shape[1]
    decoding = transformers.GenerationConfig(max_new_tokens=most, do_sample=False, eos_token_id=END, pad_token_id=0)
    allowed = forms and (lambda _, ids: forms.after(ids[begin:].tolist()))
    with torch.inference_mode():
        return model.generate(**inputs, generation_config=decoding, prefix_allowed_tokens_fn=allowed)[
            0, begin:
        ].tolist()


def test_free_answers_are_those_of_generate_one_after_the_other(model: Any) -> None:
    decode = QwenDecoder(model, end=END, most=12)
    asked = [question(0), question(1), question(2, before=7), question(1), question(3, after=400), question(0)]
    wanted = [generated(model, inputs, 12) for inputs in asked]
    assert len({tuple(answer) for answer in wanted}) == 4
    assert [decode(inputs) for inputs in asked] == wanted
    assert decode.passes == len(wanted[-1])


def test_an_answer_ends_with_its_end(model: Any) -> None:
    (first, *_) = generated(model, question(0), 12)
    assert QwenDecoder(model, end=first, most=12)(question(0)) == [first]


ANSWERS = [[5, 6, 7, size, 8, 9, color, *more, 11, END] for size in (20, 21) for color, more in ((30, [31]), (40, []))]


def test_forms_know_what_is_forced() -> None:
    forms = Forms(ANSWERS)
    assert forms.forced([]) == [5, 6, 7]
    assert forms.after([5, 6, 7]) == [20, 21]
    assert forms.forced([5, 6, 7, 21]) == [8, 9]
    assert forms.forced([5, 6, 7, 21, 8, 9, 30]) == [31, 11, END]
    assert forms.after(ANSWERS[0]) == []
    assert forms.longest == 10


def test_forced_answers_are_those_of_generate_in_as_many_passes_as_there_are_choices(model: Any) -> None:
    forms = Forms(ANSWERS)
    decode = QwenDecoder(model, end=END, most=12, forms=forms)
    wanted = [generated(model, question(seed), 12, forms) for seed in range(8)]
    assert {tuple(answer) for answer in wanted} <= {tuple(answer) for answer in ANSWERS}
    assert len({tuple(answer) for answer in wanted}) > 1
    for seed, answer in enumerate(wanted):
        assert decode(question(seed)) == answer
        assert decode.passes == 2


@pytest.mark.card
@pytest.mark.parametrize("compiler", [None, "inductor"])
def test_a_card_answers_as_the_host_does(model: Any, compiler: str | None) -> None:
    """Also where it replays what it recorded: the second time, every answer comes from recordings alone."""
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = False
    torch.compiler.reset()
    forms, there = Forms(ANSWERS), copy.deepcopy(model).to("cuda")
    decode = QwenDecoder(there, end=END, most=12, forms=forms, compiler=compiler)
    wanted = [generated(model, question(seed), 12, forms) for seed in range(4)]
    for _ in range(2):
        for seed, answer in enumerate(wanted):
            assert decode({name: value.to("cuda") for name, value in question(seed).items()}) == answer


def test_what_comes_before_the_image_is_computed_once(model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    decode = QwenDecoder(model, end=END, most=1)
    text, counts = model.model.language_model, []
    embed = text.embed_tokens.forward

    def counted(ids: Any) -> Any:
        counts.append(ids.shape[1])
        return embed(ids)

    monkeypatch.setattr(text.embed_tokens, "forward", counted)
    whole = question(0)["input_ids"].shape[1]
    for seed, before in ((0, 20), (1, 20), (2, 5), (3, 5)):
        decode(question(seed, before))
    assert counts == [whole, whole - 21, whole - 15 - 5, whole - 15 - 6]


def test_an_image_of_another_size_and_an_error_leave_nothing_behind(model: Any) -> None:
    decode = QwenDecoder(model, end=END, most=6)
    decode(question(0))
    broken = question(1)
    broken["pixel_values"] = broken["pixel_values"][:8]
    with pytest.raises(Exception, match=r".+"):
        decode(broken)
    assert decode(question(2)) == generated(model, question(2), 6)


@pytest.mark.parametrize("weights", ["model", "small"])
def test_compiled_layers_share_their_code(weights: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(weights)
    torch.compiler.reset()
    counters.clear()
    wanted = generated(model, question(0), 6)
    decode = QwenDecoder(copy.deepcopy(model), end=END, most=6, compiler="eager")
    assert decode(question(0)) == wanted
    assert counters["stats"]["unique_graphs"] == 1
    torch.compiler.reset()


@pytest.fixture(scope="module")
def small(model: Any) -> Any:
    """The same model in eight bits."""
    pytest.importorskip("torchao")
    made = copy.deepcopy(model)
    quantise(made.model.language_model.layers, "int8", "cpu")
    return made


class TestEightBits:
    """Weights of one byte, with a scale for each output, as in OpenVLA."""

    def test_the_loop_answers_as_generate_does(self, small: Any) -> None:
        forms = Forms(ANSWERS)
        free, chosen = QwenDecoder(small, end=END, most=12), QwenDecoder(small, end=END, most=12, forms=forms)
        for seed in range(4):
            assert free(question(seed)) == generated(small, question(seed), 12)
            assert chosen(question(seed)) == generated(small, question(seed), 12, forms)
            assert chosen.passes == 2


def test_a_pass_is_one_function_of_tensors(model: Any) -> None:
    """What a GPU records as one graph must trace without a break; the eager backend runs what was traced."""
    decode, wanted = QwenDecoder(model, end=END, most=6), generated(model, question(0), 6)
    decode._next = torch.compile(decode._next, backend="eager", dynamic=False, fullgraph=True)
    assert decode(question(0)) == wanted
