"""OpenVLA as a policy: its argument, its answers, and what it says of machines and checkpoints that do not do."""

import importlib
import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cognitivedrone.errors import MissingExtra, NonFiniteAction, PolicyError
from cognitivedrone.models.openvla import checkpoint as checkpoints
from cognitivedrone.models.openvla.actions import ActionStatistics
from cognitivedrone.policies import make_policy, openvla
from cognitivedrone.policies.openvla import OpenVla
from cognitivedrone.registry import make
from cognitivedrone.types import EpisodeContext, Observation

TABLE = {"openvla": "cognitivedrone.policies.openvla:OpenVla"}
INSTRUCTION = "Fly through the gate with the number equal to 3*3"

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from openvla_files import write_checkpoint

    return write_checkpoint(tmp_path_factory.mktemp("openvla"), chunk=5)


def seen(seed=0, instruction=INSTRUCTION):
    image = np.random.default_rng(seed).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    return Observation(image, instruction, np.zeros(3, np.float32), 0.8, 0.0, 0.0)


@pytest.mark.parametrize(("decoder", "length"), [("ar", 1), ("parallel", 5)])
def test_it_answers_with_commands_within_its_statistics(folder, decoder, length):
    policy = make("policy", f"openvla:{folder},decoder={decoder},device=cpu", TABLE)
    policy.reset(EpisodeContext(INSTRUCTION))
    chunk = policy.act(seen())
    assert (chunk.shape, chunk.dtype) == ((length, 4), np.float32)
    low, high = np.array(policy.checkpoint.statistics.q01), np.array(policy.checkpoint.statistics.q99)
    assert ((chunk >= low - 1e-6) & (chunk <= high + 1e-6)).all()
    assert np.array_equal(policy.act(seen()), chunk)


def test_the_observations_own_instruction_counts(folder):
    policy = make_policy(f"openvla:{folder},decoder=parallel,device=cpu")
    policy.reset(EpisodeContext(INSTRUCTION))
    one, other = policy.act(seen()), policy.act(seen(instruction="Fly home"))
    assert not np.array_equal(one, other)
    assert np.array_equal(policy.act(seen()), one)
    assert not np.array_equal(policy.act(seen(1)), one)


def test_where_the_card_is_full_a_pass_is_made_in_parts(folder, monkeypatch):
    policy = make_policy(f"openvla:{folder},decoder=parallel,device=cpu,stack=4")
    wanted = [policy.act(seen(number)) for number in range(4)]
    together, passes = policy._decode.together, []

    def full(images, prompts):
        passes.append(len(images))
        if len(images) > 1:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")
        return together(images, prompts)

    monkeypatch.setattr(policy._decode, "together", full)
    answers = policy.act_batch([policy.fork() for _ in range(4)], [seen(number) for number in range(4)])
    assert passes == [4, 2, 1, 1, 2, 1, 1]
    for answer, alone in zip(answers, wanted, strict=True):
        assert not isinstance(answer, Exception)
        assert np.allclose(answer, alone, atol=1e-4)


def test_a_card_that_is_full_before_take_off_is_a_sentence(folder, monkeypatch):
    def full(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")

    monkeypatch.setattr(openvla, "_decoder", full)
    with pytest.raises(PolicyError, match=r"^policy openvla: the card's memory is full: .*, or take quant=int8"):
        make_policy(f"openvla:{folder},device=cpu")


def test_compiled_blocks_fly_the_same_and_are_run_before_take_off(folder, monkeypatch):
    plain = make_policy(f"openvla:{folder},device=cpu")
    torch.compiler.reset()
    monkeypatch.setattr(openvla, "warmed_up", partial(openvla.warmed_up, backend="eager"))
    monkeypatch.setattr(openvla, "_USUAL_LENGTHS", (32,))
    compiled = make_policy(f"openvla:{folder},device=cpu,compiled=yes")
    for seed in range(2):
        assert np.array_equal(compiled.act(seen(seed)), plain.act(seen(seed)))


def test_where_compiling_fails_it_is_said_and_the_network_flies_as_it_is(folder, monkeypatch):
    def fails(graph, inputs):
        raise OSError("no C compiler")

    failing: Any = fails
    plain = make_policy(f"openvla:{folder},device=cpu")
    torch.compiler.reset()
    monkeypatch.setattr(openvla, "warmed_up", partial(openvla.warmed_up, backend=failing))
    with pytest.warns(RuntimeWarning, match="openvla is not compiled, which is slower: .*no C compiler"):
        policy = make_policy(f"openvla:{folder},device=cpu,compiled=yes")
    assert np.array_equal(policy.act(seen()), plain.act(seen()))


def test_bad_observations_are_refused(folder):
    policy = make_policy(f"openvla:{folder},device=cpu")
    with pytest.raises(PolicyError, match="the instruction is empty"):
        policy.reset(EpisodeContext(" "))
    small = Observation(np.zeros((10, 10, 3), np.uint8), INSTRUCTION, np.zeros(3), 0.8, 0.0, 0.0)
    with pytest.raises(PolicyError, match=r"uint8 images of shape \(256, 256, 3\), got uint8 \(10, 10, 3\)"):
        policy.act(small)


def test_an_answer_that_is_not_finite_is_not_flown(tmp_path):
    from openvla_files import STATISTICS, write_checkpoint

    from cognitivedrone.models.openvla.config import tiny_config
    from cognitivedrone.models.openvla.weights import random_network, save

    write_checkpoint(tmp_path, chunk=2)
    broken = random_network(tiny_config(chunk=2))
    with torch.no_grad():
        broken.action_head.leave.bias.fill_(float("nan"))
    save(broken, tmp_path, {"drone": STATISTICS}, tmp_path)
    with pytest.raises(NonFiniteAction, match="nan"):
        make_policy(f"openvla:{tmp_path},decoder=parallel,device=cpu").act(seen())


@pytest.mark.parametrize(
    ("argument", "says"),
    [
        (None, "needs folder; write openvla:FOLDER"),
        ("a,decoder=beam", "decoder is 'beam'; it is ar or parallel"),
        ("a,quant=", "quant is ''; it is none or int8 or int4"),
    ],
)
def test_arguments_that_do_not_do(argument, says):
    with pytest.raises(PolicyError, match=says):
        make_policy("openvla" if argument is None else f"openvla:{argument}")


class TestBeforeAnythingHeavyIsLoaded:
    @pytest.fixture(autouse=True)
    def nothing_is_loaded(self, monkeypatch):
        from cognitivedrone.models.openvla import weights

        def refuse(*_, **__):
            raise AssertionError("the weights were loaded")

        monkeypatch.setattr(weights, "load", refuse)

    def test_too_little_memory(self, folder, monkeypatch):
        monkeypatch.setattr(checkpoints, "free_memory", lambda: 1_000_000)
        with pytest.raises(PolicyError, match=r"needs 0\.0 GB of memory, has 0\.0 GB free; .*--policy small"):
            make_policy(f"openvla:{folder},device=cpu")

    @pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
    def test_a_gpu_that_is_not_there(self, folder):
        with pytest.raises(PolicyError, match=r"needs 0\.0 GB of GPU memory, but this machine has no GPU .*device=cpu"):
            make_policy(f"openvla:{folder},device=cuda")

    @pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
    def test_a_large_network_and_nothing_but_the_host(self, folder, monkeypatch):
        monkeypatch.setattr(checkpoints, "needed_bytes", lambda *_: 15_100_000_000)
        monkeypatch.setattr(checkpoints, "free_memory", lambda: 64_000_000_000)
        with pytest.raises(
            PolicyError, match=r"needs 15\.1 GB of GPU memory, .* 64\.0 GB of free main.*device=cpu, which takes sec"
        ):
            OpenVla(folder)
        with pytest.raises(AssertionError, match="the weights were loaded"):  # whoever asks for it gets it
            make_policy(f"openvla:{folder},device=cpu")

    def test_too_little_of_the_host_to_quantise(self, folder, monkeypatch):
        monkeypatch.setattr(checkpoints, "free_memory", lambda: 1_000_000)
        with pytest.raises(
            PolicyError, match=r"quant=int8: the whole network is read .* 0\.0 GB of the host's memory, has 0\.0 GB"
        ):
            make_policy(f"openvla:{folder},quant=int8,device=cpu")

    def test_four_bits_on_the_host(self, folder):
        with pytest.raises(PolicyError, match="quant=int4 is for GPUs"):
            make_policy(f"openvla:{folder},quant=int4,device=cpu")

    def test_no_head_for_chunks(self, folder, tmp_path):
        copy = Path(shutil.copytree(folder, tmp_path / "plain"))
        output = json.loads((copy / "config.json").read_text())
        output["cognitivedrone"]["chunk"] = None
        (copy / "config.json").write_text(json.dumps(output))
        with pytest.raises(PolicyError, match="no head for decoder=parallel; use decoder=ar"):
            make_policy(f"openvla:{copy},decoder=parallel,device=cpu")

    @pytest.mark.parametrize("package", ["torch", "transformers", "tokenizers"])
    def test_a_library_that_is_missing(self, folder, monkeypatch, package):
        real = importlib.import_module

        def without(name, *rest):
            if name == package:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
            return real(name, *rest)

        monkeypatch.setattr(importlib, "import_module", without)
        with pytest.raises(MissingExtra, match=rf"{package} is not installed.*cognitivedrone\[openvla\]"):
            make_policy(f"openvla:{folder},device=cpu")


@pytest.mark.parametrize("decoder", ["ar", "parallel"])
@pytest.mark.parametrize("stack", [1, 3])
def test_several_flights_at_once_get_the_answers_of_each_alone(folder, decoder, stack):
    policy = make_policy(f"openvla:{folder},decoder={decoder},device=cpu,stack={stack}")
    texts = [INSTRUCTION, "Fly home", "Fly through the red gate", " ", "Fly home"]
    forks = [policy.fork() for _ in texts]
    observations = [seen(number, text) for number, text in enumerate(texts)]
    answers = policy.act_batch(forks, observations)
    assert isinstance(answers[3], PolicyError)
    for number in (0, 1, 2, 4):
        answer = answers[number]
        assert not isinstance(answer, Exception)
        assert np.allclose(answer, policy.act(observations[number]), atol=1e-4)


def test_a_pass_that_fails_fails_for_every_flight_in_it(folder, monkeypatch):
    policy = make_policy(f"openvla:{folder},decoder=parallel,device=cpu,stack=2")

    def fail(*_):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(policy._decode, "together", fail)
    answers = policy.act_batch([policy.fork(), policy.fork()], [seen(), seen()])
    assert [str(answer) for answer in answers] == ["out of memory"] * 2


RACING = ActionStatistics(tuple(-1.0 for _ in range(7)), tuple(1.0 + n for n in range(7)), (True,) * 7)


@pytest.fixture(scope="module")
def racing(tmp_path_factory):
    """A checkpoint with the form of the published racing model: seven numbers, several data sets, words elsewhere."""
    from openvla_files import write_checkpoint

    folder = write_checkpoint(tmp_path_factory.mktemp("racing") / "weights")
    config = json.loads((folder / "config.json").read_text())
    config["norm_stats"] = {name: {"action": RACING.to_json()} for name in ("drone_set3", "drone_set4")}
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "dataset_statistics.json").unlink(missing_ok=True)
    words = folder.parent / "processor"
    words.mkdir()
    (folder / "tokenizer.json").rename(words / "tokenizer.json")
    return folder


def test_four_of_seven_numbers_fly(racing):
    """Each is scaled, and those in between only steer the numbers after them."""
    named = {"unnorm_key": "drone_set4", "tokenizer": racing.parent / "processor", "device": "cpu"}
    four = OpenVla(racing, dims="0+1+2+5", scale="2+1+0.5+1", **named)
    reordered = OpenVla(racing, dims="5+2+1+0", **named)
    for policy in (four, reordered):
        policy.reset(EpisodeContext(INSTRUCTION))
    found, others = four.act(seen()), reordered.act(seen())
    assert found.shape == (1, 4)
    np.testing.assert_allclose(found[0] / [2, 1, 0.5, 1], others[0, [3, 2, 1, 0]], rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, r"statistics of 2 data sets, none with the 4 numbers .* drone_set3 \(7\), drone_set4 \(7\)"),
        ({"unnorm_key": "drone_set4"}, r"'drone_set4' have 7 numbers; .* such as dims=0\+1\+2\+5"),
        ({"dims": "0+1+2+7", "unnorm_key": "drone_set3"}, "have 7 numbers"),
        ({"dims": "0+1+2", "unnorm_key": "drone_set3"}, "is not 4 numbers"),
        ({"dims": "0+1+2+5", "unnorm_key": "drone_set9"}, r"there are drone_set3 \(7\), drone_set4 \(7\)"),
    ],
)
def test_a_wrong_mixture_says_which_keys_and_widths_there_are(racing, options, says):
    with pytest.raises(PolicyError, match=says):
        OpenVla(racing, tokenizer=racing.parent / "processor", device="cpu", **options)
