"""Networks train in bfloat16 only where the processor multiplies it."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from accelerate import Accelerator
from quick_trainings import train_here
from torch.nn.modules.module import register_module_forward_hook

from cognitivedrone.training.launch import RECIPES
from cognitivedrone.training.trainer import trainer, training_task
from cognitivedrone.training.trainer.training_task import Given, multiplies_bf16

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")

INTEL = "processor : 0\nmodel name : bf16 in name alone\nflags\t\t: fpu sse2 avx512f avx512_bf16 sha_ni\n"
ARM = "processor : 0\nFeatures\t: fp asimd sve bf16 i8mm\n"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (INTEL, True),
        (INTEL.replace("avx512_bf16", "amx_bf16"), True),
        (INTEL.replace("avx512_bf16 ", ""), False),
        (ARM, True),
        (ARM.replace("bf16 ", ""), False),
        ("", False),
        (None, False),  # a system that does not say
    ],
)
def test_what_a_processor_multiplies(tmp_path, text, found):
    path = tmp_path / "cpuinfo"
    if text is not None:
        path.write_text(text)
    assert multiplies_bf16(path) is found


@pytest.mark.parametrize("multiplies", [True, False])
def test_a_card_is_asked_whether_it_multiplies_bf16_itself(monkeypatch, multiplies):
    asked = []

    def is_bf16_supported(including_emulation):
        asked.append(including_emulation)
        return multiplies

    cuda = SimpleNamespace(is_available=lambda: True, is_bf16_supported=is_bf16_supported)
    monkeypatch.setattr(training_task, "torch", SimpleNamespace(cuda=cuda))
    assert training_task.trains_in_bf16.__wrapped__() is multiplies
    assert asked == [False]


@pytest.mark.usefixtures("no_accelerator")
@pytest.mark.parametrize("casts", [True, False])
def test_a_training_computes_in_what_suits_the_machine(tmp_path, monkeypatch, language_checkpoint, casts):
    monkeypatch.setattr(trainer, "trains_in_bf16", lambda: casts)
    task = replace(RECIPES["debug"], steps=1, fly_every=0).training(Given(start=language_checkpoint))
    seen = set()

    def note(module, _, output):
        if isinstance(module, torch.nn.Linear) and module.training:
            seen.add(output.dtype)

    hook = register_module_forward_hook(note)
    try:
        train_here(tmp_path, task)
    finally:
        hook.remove()
    assert seen == {torch.bfloat16 if casts else torch.float32}
    # As the next training of this process asks for it.
    Accelerator(mixed_precision="bf16", cpu=not torch.cuda.is_available())
