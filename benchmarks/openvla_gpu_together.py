"""A reasoner of Qwen2.5-VL-7B's sizes with random weights, and the policy beside it on one card: for `openvla_gpu.py`.

What the reasoner sees is as long as in flight, the prompt of a gate and one frame, but made of random numbers: neither
its image processor nor its tokenizer takes part.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
import transformers
from openvla_gpu_report import Machine, Report
from torch import Tensor

from cognitivedrone.models.openvla.checkpoint import Quantisation
from cognitivedrone.models.openvla.weights import quantise
from cognitivedrone.models.qwen_decoder import Forms, QwenDecoder
from cognitivedrone.types import CONTROL_HZ

REASONER_HZ = 2
LATE_S = 0.010
"""A deadline counts as missed when its answer comes later than this after it."""
ANSWER = 25
"""Tokens: as many as {"size": "small", "color": "red", "shape": "round"} and its end take."""
PROMPT = 230
"""Tokens around the image: the shipped prompt and an instruction."""
GRID = (18, 18)
"""Patches of a 256x256 frame, 252x252 after rounding; each token is 2x2 of them."""

TEXT_7B = {
    "hidden_size": 3584,
    "intermediate_size": 18_944,
    "num_hidden_layers": 28,
    "num_attention_heads": 28,
    "num_key_value_heads": 4,
    "vocab_size": 152_064,
    "rms_norm_eps": 1e-6,
    "rope_parameters": {"rope_type": "default", "rope_theta": 1e6, "mrope_section": [16, 24, 24]},
}
VISION_7B = {"hidden_size": 1280, "out_hidden_size": 3584, "tokens_per_second": 2}
TOKENS_7B = {"image_token_id": 151_655, "video_token_id": 151_656, "vision_start_token_id": 151_652}
"""What the published Qwen2.5-VL-7B-Instruct (arXiv 2502.13923) sets of its configuration class; the rest is default."""
TEXT_TINY = {
    "hidden_size": 32,
    "intermediate_size": 48,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "num_key_value_heads": 1,
    "vocab_size": 300,
    "bos_token_id": 1,
    "eos_token_id": 2,
    "rope_parameters": {"rope_type": "default", "rope_theta": 1e4, "mrope_section": [2, 3, 3]},
}
VISION_TINY = {
    "depth": 2,
    "hidden_size": 32,
    "intermediate_size": 48,
    "num_heads": 2,
    "out_hidden_size": 32,
    "fullatt_block_indexes": [1],
}
TOKENS_TINY = {"image_token_id": 297, "video_token_id": 298, "vision_start_token_id": 299}


def reasoner_config(*, large: bool) -> Any:
    """Transformers' configuration of Qwen2.5-VL-7B, or of one in small."""
    text, vision, tokens = (TEXT_7B, VISION_7B, TOKENS_7B) if large else (TEXT_TINY, VISION_TINY, TOKENS_TINY)
    return transformers.Qwen2_5_VLConfig(text_config=text, vision_config=vision, **tokens)  # type: ignore[arg-type]


def random_reasoner(machine: Machine, quantisation: Quantisation) -> Any:
    """A reasoner's model with random weights, made where it is to run."""
    config = reasoner_config(large=machine.large)
    torch.manual_seed(0)
    with torch.device(machine.device):
        model = transformers.AutoModelForImageTextToText.from_config(  # type: ignore[no-untyped-call]
            config, dtype=machine.dtype, attn_implementation="sdpa"
        )
    model.eval().requires_grad_(False)
    quantise(model.model.language_model.layers, quantisation, machine.device)
    return model


def some_inputs(model: Any, seed: int = 0) -> dict[str, Tensor]:
    """A prompt and a frame, as `vlm-local` gives them to a model."""
    config, device = model.config, model.lm_head.weight.device
    generator = torch.Generator().manual_seed(seed)
    vision = config.vision_config
    seen = GRID[0] * GRID[1] // vision.spatial_merge_size**2
    words = torch.randint(10, config.vision_start_token_id, (PROMPT,), generator=generator)
    before, after = words[:20], words[20:]
    begin = torch.tensor([config.vision_start_token_id])
    ids = torch.cat([before, begin, torch.full((seen,), config.image_token_id), after])[None]
    numbers = vision.in_channels * vision.temporal_patch_size * vision.patch_size**2
    made = {
        "input_ids": ids,
        "attention_mask": torch.ones_like(ids),
        "mm_token_type_ids": (ids == config.image_token_id).int(),
        "pixel_values": torch.randn(GRID[0] * GRID[1], numbers, generator=generator).to(model.lm_head.weight.dtype),
        "image_grid_thw": torch.tensor([[1, *GRID]]),
    }
    return {name: value.to(device) for name, value in made.items()}


class Generated:
    """Answers by Transformers' own loop."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._decoding = transformers.GenerationConfig(  # type: ignore[no-untyped-call]
            min_new_tokens=ANSWER, max_new_tokens=ANSWER, do_sample=False, eos_token_id=2, pad_token_id=0
        )

    def __call__(self, inputs: dict[str, Tensor]) -> list[int]:
        """`ANSWER` ids of words."""
        with torch.inference_mode():
            tokens = self._model.generate(**inputs, generation_config=self._decoding)
        answer: list[int] = tokens[0, inputs["input_ids"].shape[1] :].tolist()
        return answer


class Recorded:
    """The same answers by our own loop, or with `forced` ones, as `vlm-local` gives them."""

    def __init__(self, model: Any, *, forced: bool = False, compiler: str | None = None) -> None:
        self.decode = QwenDecoder(
            model, end=-1, most=ANSWER, forms=Forms(some_answers()) if forced else None, compiler=compiler
        )

    def __call__(self, inputs: dict[str, Tensor]) -> list[int]:
        """`ANSWER` ids of words."""
        return self.decode(inputs)


def some_answers() -> list[list[int]]:
    """Answers as the schema has them: `ANSWER` words, of which three are chosen, of 2, 4 and 3 that are possible."""
    first, second, third = 6, 12, 18
    made = []
    for size, color, shape in itertools.product(range(2), range(4), range(3)):
        answer = [*range(20, 20 + ANSWER)]
        answer[first], answer[second], answer[third] = 100 + size, 110 + color, 120 + shape
        made.append(answer)
    return made


@dataclass(frozen=True)
class Pace:
    """How a part kept its rate."""

    times_ms: np.ndarray
    missed: int
    """Deadlines whose answer came more than `LATE_S` after them, or not at all."""
    due: int


def keep_pace(work: Callable[[], object], hz: float, seconds: float, begin: float) -> Pace:
    """Work at `begin`, s on the monotonic clock, and each period after it, each time to be done by the next.

    The deadlines are absolute: a late caller continues at once, and has to catch up.
    """
    due, times, missed = round(seconds * hz), [], 0
    for number in range(due):
        if time.monotonic() > begin + seconds:
            missed += due - number
            break
        time.sleep(max(0.0, begin + number / hz - time.monotonic()))
        since = time.perf_counter()
        work()
        times.append((time.perf_counter() - since) * 1e3)
        missed += time.monotonic() > begin + (number + 1) / hz + LATE_S
    return Pace(np.array(times), missed, due)


def together(report: Report, quantisation: Quantisation, policy: Callable[[], object], seconds: float) -> None:
    """Measure a policy at 10 Hz, alone and beside each kind of reasoner at 2 Hz in a thread of its own."""
    alone = keep_pace(policy, CONTROL_HZ, seconds / 4, time.monotonic() + 0.1)
    _tell(report, f"{quantisation} policy, alone", alone, report.machine.peak())
    model = random_reasoner(report.machine, quantisation)
    inputs = some_inputs(model)
    compiler = report.machine.compiler
    ways: dict[str, Callable[[], Callable[[dict[str, Tensor]], list[int]]]] = {
        "generate()": lambda: Generated(model),
        "recorded": lambda: Recorded(model),
        "recorded, compiled": lambda: Recorded(model, compiler=compiler),
        "recorded, compiled, forced words": lambda: Recorded(model, forced=True, compiler=compiler),
    }
    for way, make in ways.items():
        with report.measuring(f"{quantisation} policy and reasoner, {way}"):
            think = make()
            for _ in range(2):  # kernels are chosen, and recorded, before take-off
                think(inputs)
            report.machine.wait()
            report.machine.forget()
            begin = time.monotonic() + 0.1
            with ThreadPoolExecutor(1) as pool:
                thinking = pool.submit(keep_pace, partial(think, inputs), REASONER_HZ, seconds, begin)
                flying = keep_pace(policy, CONTROL_HZ, seconds, begin)
                thought = thinking.result()
            _tell(report, f"{quantisation} policy, reasoner by {way}", flying, report.machine.peak())
            _tell(report, f"{quantisation} reasoner by {way}", thought, report.machine.peak())


def _tell(report: Report, name: str, pace: Pace, peak: str) -> None:
    median, slow = np.percentile(pace.times_ms, [50, 99])
    missed, kept = pace.missed / pace.due, len(pace.times_ms) / pace.due
    report.row(name, f"{median:.1f} ms", f"{slow:.1f} ms", f"{missed:.2%}", f"{kept:.1%}", peak)
