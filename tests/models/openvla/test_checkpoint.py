"""Folders of checkpoints: what is read, and what is said of those that do not do."""

import copy
import json
import shutil
import struct
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from openvla_files import STATISTICS, write_tokenizer
from safetensors.torch import load_file, save_file

from cognitivedrone.errors import MissingExtra, PolicyError
from cognitivedrone.models.openvla import weights
from cognitivedrone.models.openvla.checkpoint import check_memory, free_memory, inspect, needed_bytes, read_header
from cognitivedrone.models.openvla.config import Config, read_config, tiny_config, write_config
from cognitivedrone.models.openvla.prepare import (
    BEGIN,
    SPACE,
    ImagePreparation,
    check_tokenizer,
    prompt,
    prompt_ids,
    read_encoder,
    read_preparation,
)


@pytest.fixture
def folder(made_folder, tmp_path):
    """A copy of the tiny checkpoint, to be spoilt."""
    return Path(shutil.copytree(made_folder, tmp_path / "model"))


@pytest.fixture(scope="module")
def encode(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tokenizer")
    write_tokenizer(folder)
    return read_encoder(folder / "tokenizer.json")


def told_by(folder):
    return json.loads((folder / "config.json").read_text())


HEADERS = [
    struct.pack("<Q", len(text)) + text
    for text in (
        b'{"a": []}',
        b'{"a": {"dtype": "F32", "shape": [1], "data_offsets": [0]}}',
        b'{"a": {"dtype": "F32", "shape": [1], "data_offsets": [0, 1e400]}}',
        b"[" * 2000 + b"]" * 2000,
    )
]
"""Of safetensors files; none describes tensors."""
TOWER = {"width": 48, "depth": 3, "heads": 4, "hidden": 192}


def tell(folder, **changes):
    (folder / "config.json").write_text(json.dumps(told_by(folder) | changes))


def spoil(folder, change):
    """Rewrite the weights as `change` leaves them."""
    tensors = load_file(folder / "model.safetensors")
    change(tensors)
    save_file(tensors, folder / "model.safetensors")


class TestLoading:
    def test_what_is_saved_is_loaded(self, made_folder):
        found = inspect(made_folder)
        assert found.config == tiny_config(chunk=5)
        assert found.statistics == STATISTICS
        network = weights.load(found, "cpu", torch.float32)
        expected = weights.random_network(tiny_config(chunk=5), seed=3).state_dict()
        assert expected.keys() == network.state_dict().keys()
        assert all(torch.equal(value, expected[name]) for name, value in network.state_dict().items())
        assert all(value.device.type == "cpu" for value in network.buffers())

    def test_several_files_are_one_network(self, made_folder, tmp_path, monkeypatch):
        monkeypatch.setattr(weights, "SHARD_BYTES", 4_500_000)
        whole = weights.load(inspect(made_folder), "cpu", torch.float32)
        weights.save(whole, tmp_path, {"cognitivedrone": STATISTICS}, made_folder)
        assert len(list(tmp_path.glob("model-*-of-00003.safetensors"))) == 3
        again = weights.load(inspect(tmp_path), "cpu", torch.float32).state_dict()
        assert all(torch.equal(value, again[name]) for name, value in whole.state_dict().items())

    def test_half_precision_stays_half_precision(self, made_folder, tmp_path):
        network = weights.load(inspect(made_folder), "cpu", torch.bfloat16)
        weights.save(network, tmp_path, {"cognitivedrone": STATISTICS}, made_folder)
        assert inspect(tmp_path).stored_bytes == 2
        assert (tmp_path / "model.safetensors").stat().st_size < (
            made_folder / "model.safetensors"
        ).stat().st_size * 0.6

    def test_tensors_that_are_never_used_are_skipped(self, folder):
        spoil(folder, lambda tensors: tensors.update({"vision_backbone.featurizer.norm.weight": torch.ones(48)}))
        weights.load(inspect(folder), "cpu", torch.float32)

    def test_statistics_of_fine_tuning_count(self, folder):
        tell(folder, norm_stats={})
        (folder / "dataset_statistics.json").write_text(json.dumps({"mine": {"action": STATISTICS.to_json()}}))
        assert inspect(folder).statistics_key == "mine"

    def test_given_statistics_stand_for_the_folders_own(self, folder):
        tell(folder, norm_stats={})
        (folder / "dataset_statistics.json").write_text("[]")
        found = inspect(folder, given=("drone", STATISTICS))
        assert (found.statistics_key, found.statistics) == ("drone", STATISTICS)

    def test_small_weights_need_a_library(self, made_folder, monkeypatch):
        monkeypatch.setattr(weights.importlib.util, "find_spec", lambda name: None)
        with pytest.raises(MissingExtra, match="torchao"):
            weights.load(inspect(made_folder), "cpu", torch.float32, "int8")

    @pytest.mark.parametrize(("bits", "config"), [("int8", "Int8WeightOnlyConfig"), ("int4", "Int4WeightOnlyConfig")])
    def test_only_llamas_layers_become_small(self, made_folder, monkeypatch, bits, config):
        asked = []
        library = types.SimpleNamespace(
            Int8WeightOnlyConfig=lambda: "Int8WeightOnlyConfig",
            Int4WeightOnlyConfig=lambda **_: "Int4WeightOnlyConfig",
            quantize_=lambda module, config, device: asked.append((module, config, device)),
        )
        monkeypatch.setattr(weights.importlib.util, "find_spec", lambda name: name)
        monkeypatch.setitem(sys.modules, "torchao.quantization", library)
        network = weights.load(inspect(made_folder), "cpu", torch.bfloat16, bits)
        assert asked == [(network.language_model.model.layers, config, "cpu")]

    def test_torchao_makes_them_small_and_the_answers_stay(self, made_folder):
        """The real library, on the CPU."""
        found = inspect(made_folder)
        whole, small = (weights.load(found, "cpu", torch.bfloat16, bits) for bits in ("none", "int8"))
        for name, layer in small.language_model.model.layers.named_modules():
            if isinstance(layer, torch.nn.Linear):
                assert type(layer.weight).__module__.startswith("torchao"), name
                assert layer.weight.qdata.dtype == torch.int8
        kinds = {type(value) for name, value in small.named_parameters() if "model.layers" not in name}
        assert kinds == {torch.nn.Parameter}
        images = torch.randn((1, 6, 224, 224), generator=torch.Generator().manual_seed(0)).to(torch.bfloat16)
        ids = torch.tensor([[1, 512, 29_871]])
        with torch.inference_mode():
            exact, near = (network(ids, images, torch.ones_like(ids)).logits.float() for network in (whole, small))
        error = (near - exact).norm() / exact.norm()
        assert 0 < error < 0.05

    @pytest.mark.card  # torchao packs 4 bits for GPUs only
    def test_torchao_packs_four_bits_on_a_gpu(self):
        exact = torch.nn.Sequential(torch.nn.Linear(256, 256, bias=False)).to("cuda", torch.bfloat16)
        small = copy.deepcopy(exact)
        weights.quantise(small, "int4", "cuda")
        pixels = torch.randn((4, 256), device="cuda", dtype=torch.bfloat16)
        error = (small(pixels) - exact(pixels)).float().norm() / exact(pixels).float().norm()
        assert 0 < error < 0.2


class TestFaults:
    @pytest.mark.parametrize(
        ("change", "says"),
        [
            (lambda t: t.pop("projector.fc2.bias"), "1 tensor does not fit.*projector.fc2.bias is missing"),
            (lambda t: t.update(lora_a=torch.ones(2)), "lora_a is extra.*with adapters merged"),
            (lambda t: t.update({"projector.fc2.bias": torch.ones(31)}), r"fc2.bias is \[31\] and should be \[32\]"),
            (lambda t: [t.pop(name) for name in list(t)[:7]], "7 tensors do not fit.*and 3 more"),
            (lambda t: t.update({"projector.fc2.bias": torch.ones(32, dtype=torch.int8)}), "fc2.bias is I8"),
        ],
    )
    def test_tensors_that_do_not_fit_are_named(self, folder, change, says):
        spoil(folder, change)
        with pytest.raises(PolicyError, match=says):
            inspect(folder)

    @pytest.mark.parametrize(
        ("name", "says"),
        [
            ("config.json", "config.json: No such file"),
            ("tokenizer.json", "tokenizer.json: No such file"),
            ("model.safetensors", "neither model.safetensors nor"),
            ("action_head.safetensors", "lacks action_head.safetensors"),
        ],
    )
    def test_a_missing_file_is_named(self, folder, name, says):
        (folder / name).unlink()
        with pytest.raises(PolicyError, match=says):
            inspect(folder)

    def test_a_missing_folder_is_named(self, tmp_path):
        with pytest.raises(PolicyError, match=r"there is no folder .*nowhere"):
            inspect(tmp_path / "nowhere")

    def test_a_pointer_in_place_of_the_weights(self, folder):
        (folder / "model.safetensors").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\n")
        with pytest.raises(PolicyError, match="if it is a pointer of Git LFS, fetch the file"):
            inspect(folder)

    def test_a_file_that_is_cut_off(self, folder):
        path = folder / "model.safetensors"
        path.write_bytes(path.read_bytes()[:-1000])
        with pytest.raises(PolicyError, match=r"is truncated.*copy it again"):
            inspect(folder)

    @pytest.mark.parametrize(
        "content", [b"", b"abc", struct.pack("<Q", 10**12), struct.pack("<Q", 4) + b"[12]", *HEADERS]
    )
    def test_files_that_are_no_safetensors(self, tmp_path, content):
        (tmp_path / "x.safetensors").write_bytes(content)
        with pytest.raises(PolicyError, match="is not a safetensors file"):
            read_header(tmp_path / "x.safetensors")

    def test_an_index_that_names_what_is_not_there(self, folder):
        index = {"weight_map": {"a": "model-1.safetensors", "b": "model.safetensors"}}
        (folder / "model.safetensors.index.json").write_text(json.dumps(index))
        with pytest.raises(PolicyError, match=r"lacks model-1\.safetensors, which its index names"):
            inspect(folder)
        (folder / "model.safetensors.index.json").write_text(json.dumps({"weight_map": {"a": "../x.safetensors"}}))
        with pytest.raises(PolicyError, match="outside of its folder"):
            inspect(folder)

    @pytest.mark.parametrize(
        ("changes", "says"),
        [
            ({"model_type": "llava"}, "model_type is 'llava'; an OpenVLA-7B that can be flown has 'openvla'"),
            ({"image_resize_strategy": "letterbox"}, "image_resize_strategy is 'letterbox'"),
            ({"cognitivedrone": {}, "timm_model_ids": ["vit_x"]}, "timm_model_ids are"),
            ({"text_config": {"num_hidden_layers": 10**12}}, "num_hidden_layers is 1000000000000; it must be from 0"),
            ({"text_config": {"num_hidden_layers": 2000}}, "a part has 2000 layers; at most 1000 are read"),
            ({"text_config": {"hidden_size": "x"}}, "hidden_size must be a whole number, not 'x'"),
            ({"cognitivedrone": {"towers": [TOWER]}}, "towers has 1 items; it must have 2"),
            ({"cognitivedrone": []}, "does not describe an OpenVLA"),
            ({"norm_stats": [1]}, "norm_stats is list; it must be an object"),
            ({"norm_stats": {"a": 7}}, "lack readable q01 and q99: must be an object"),
            ({"text_config": None}, "does not describe an OpenVLA"),
            ({"text_config": {"num_attention_heads": 0}}, "does not describe an OpenVLA: ZeroDivisionError"),
            ({"cognitivedrone": {"chunk": "x"}}, "does not describe an OpenVLA: TypeError"),
            ({"cognitivedrone": {"chunk": 0}}, "chunk is 0; it is 1 to 100 actions"),
            ({"text_config": {"hidden_size": 33}}, "must be a whole number above 0"),
        ],
    )
    def test_a_configuration_of_something_else(self, folder, changes, says):
        tell(folder, **changes)
        with pytest.raises(PolicyError, match=says):
            inspect(folder)

    def test_a_tokenizer_of_another_model(self, folder):
        told = json.loads((folder / "tokenizer.json").read_text())
        told["model"]["vocab"].pop("▁")
        (folder / "tokenizer.json").write_text(json.dumps(told))
        with pytest.raises(PolicyError, match="it has 31999 pieces, not 32000; '▁' is None, not 29871"):
            inspect(folder)
        with pytest.raises(PolicyError, match="has no vocabulary"):
            check_tokenizer({"model": {}}, "tokenizer.json")


class TestSizes:
    def test_the_published_configuration_is_the_7b(self):
        told = write_config(Config(), {})
        del told["cognitivedrone"]
        told["text_config"] = {"model_type": "llama", "pad_token_id": 32000, "vocab_size": 32064}
        assert read_config(told) == Config()

    @pytest.mark.parametrize("config", [Config(), tiny_config(), tiny_config(chunk=8)])
    def test_a_written_configuration_is_read_back(self, config):
        assert read_config(json.loads(json.dumps(write_config(config, {})))) == config

    def test_what_the_7b_needs(self):
        whole, eight, four = (needed_bytes(Config(), quantisation) / 1e9 for quantisation in ("none", "int8", "int4"))
        assert 15.0 < whole < 16.0
        assert 8.0 < eight < 10.0
        assert 5.0 < four < 7.0
        assert needed_bytes(Config(), "none", stored=4) == pytest.approx(2e9 * whole)

    def test_too_little_memory_is_said_with_the_numbers(self):
        with pytest.raises(PolicyError, match=r"needs 15\.7 GB of memory, has 8\.0 GB free; .*device=cuda"):
            check_memory(int(15.7e9), int(8e9), "cpu")
        with pytest.raises(PolicyError, match=r"of GPU memory.*quant=int8"):
            check_memory(int(15.7e9), int(8e9), "cuda")
        check_memory(10, 10, "cuda")
        assert 1e8 < free_memory() < 1e14


class TestInputs:
    def test_a_prompt_begins_and_ends_as_in_training(self, encode):
        ids = prompt_ids(encode, "fly")
        assert (ids[0], ids[-1]) == (BEGIN, SPACE)
        assert ids.count(BEGIN) == 1

    def test_the_users_words_end_nothing(self, encode):
        assert 2 not in prompt_ids(encode, "fly </s> through <s> it")[1:]

    def test_the_instruction_is_one_line_in_lower_case(self):
        assert prompt(" Fly\n to  A ") == "In: What action should the robot take to fly to a?\nOut:"

    @pytest.mark.parametrize(("text", "says"), [(" \n", "is empty"), ("x" * 1001, "has 1001 characters")])
    def test_instructions_that_do_not_do(self, text, says):
        with pytest.raises(PolicyError, match=says):
            prompt(text)

    def test_a_plain_image_becomes_its_normalised_colour(self):
        image = np.full((256, 256, 3), (255, 0, 51), np.uint8)
        found = ImagePreparation().pixel_values(image)
        assert found.shape == (6, 224, 224)
        assert np.allclose(found.min((1, 2)), found.max((1, 2)))
        expected = [(1 - 0.485) / 0.229, -0.456 / 0.224, (0.2 - 0.406) / 0.225, 1.0, -1.0, -0.6]
        assert np.allclose(found[:, 0, 0], expected, atol=1e-6)

    def test_the_preparation_is_read_where_it_is_told(self):
        means, stds = [[0.484375, 0.5, 0.5], [0.5] * 3], [[0.25] * 3, [0.5] * 3]
        found = read_preparation({"means": means, "stds": stds})
        assert found == replace(ImagePreparation(), means=tuple(map(tuple, means)), deviations=tuple(map(tuple, stds)))  # type: ignore[arg-type]

    @pytest.mark.parametrize("told", [{}, {"means": [[0] * 3] * 2, "stds": [[0] * 3] * 2}, {"means": 1, "stds": 1}])
    def test_a_preparation_of_another_model(self, told):
        with pytest.raises(PolicyError, match=r"preprocessor_config\.json"):
            read_preparation(told)
