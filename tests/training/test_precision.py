"""Networks train in bfloat16 only where the processor multiplies it."""

from __future__ import annotations

import pytest

from cognitivedrone.training.common.precision import multiplies_bf16, precision

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
    ],
)
def test_what_a_processor_multiplies(tmp_path, text, found):
    path = tmp_path / "cpuinfo"
    path.write_text(text)
    assert multiplies_bf16(path) is found


def test_a_system_that_does_not_say_is_taken_for_one_that_does_not(tmp_path):
    assert not multiplies_bf16(tmp_path / "cpuinfo")


def test_this_machine_has_a_precision():
    assert precision() in ("bf16", "no")
