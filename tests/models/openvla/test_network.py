"""The network and its decoders, on random weights: what must hold whatever they are."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch._dynamo.utils import counters

from cognitivedrone.models.openvla.compiled import compile_blocks, uncompile
from cognitivedrone.models.openvla.config import PATCHES, Config, tiny_config
from cognitivedrone.models.openvla.decode import Autoregressive, Parallel, Runner, chunk_actions, greedy_tokens
from cognitivedrone.models.openvla.network import IGNORED
from cognitivedrone.models.openvla.prepare import ImagePreparation
from cognitivedrone.models.openvla.weights import empty_network, fuse, quantise, random_network

IDS = [1, 512, 29_901, 1724, 3158, 881, 278, 29_871]


def some_pixels(seed=0, count=1):
    return np.random.default_rng(seed).normal(size=(count, 6, 224, 224)).astype(np.float32)


@pytest.fixture(scope="module")
def network():
    made = random_network(tiny_config(chunk=3), seed=1).requires_grad_(False)
    # Larger weights, so that the answer depends on the inputs and not on the last word alone.
    for name, values in made.named_parameters():
        if values.ndim > 1:
            values.mul_(8.0 if "language_model" in name else 2.0)
    return made


def of_depth(config, layers):
    """A configuration with so many layers of the language, and of each tower one more, as the last is never run."""
    towers = [replace(tower, depth=layers + 1) for tower in (config.dino, config.siglip)]
    language = replace(config.language, num_hidden_layers=layers)
    return replace(config, dino=towers[0], siglip=towers[1], language=language)


def uncached(network, pixels, ids):
    """Four words by whole passes through the network, without any cache or padding."""
    ids = list(ids)
    for _ in range(4):
        ids.append(int(network(torch.tensor([ids]), torch.from_numpy(pixels)).logits[0, -1].argmax()))
    return ids[-4:]


@pytest.mark.parametrize("seed", range(4))
def test_the_cache_and_the_padding_change_no_word(network, seed):
    pixels = some_pixels(seed)
    ids = [*IDS, *np.random.default_rng(seed).integers(100, 31_000, 3 + 20 * seed).tolist()]
    decode = Autoregressive(network)
    assert decode.tokens(pixels[0], ids).tolist() == uncached(network, pixels, ids)


def test_a_step_is_one_function_of_tensors_without_a_look_at_a_value():
    # What a GPU records as one graph must trace without a break; the eager backend runs what was traced.
    network = random_network(of_depth(tiny_config(), 1)).eval()
    step = torch.compile(
        lambda *inputs: greedy_tokens(network, *inputs), backend="eager", dynamic=False, fullgraph=True
    )
    inputs = (torch.from_numpy(some_pixels()), torch.tensor([IDS]), torch.tensor([len(IDS)]))
    with torch.inference_mode():
        assert step(*inputs).tolist() == greedy_tokens(network, *inputs).tolist()


def test_the_7b_fits_together():
    # On the meta device shapes are computed, and nothing else.
    large = empty_network(of_depth(Config(chunk=8), 2)).to(torch.bfloat16)
    pixels = torch.empty(1, 6, 224, 224, device="meta")
    ids, count = (torch.empty(size, dtype=torch.int64, device="meta") for size in ((1, 32), (1,)))
    with torch.inference_mode():
        tokens = greedy_tokens(large, pixels, ids, count)
        actions = chunk_actions(large, pixels, ids, count)
    assert (tokens.shape, tokens.dtype) == ((1, 4), torch.int64)
    assert (actions.shape, actions.dtype) == ((1, 8, 4), torch.bfloat16)


def test_prompts_of_several_lengths_are_decoded_together_as_each_alone(network):
    pixels = np.concatenate([some_pixels(seed) for seed in range(3)])
    prompts = [IDS, [*IDS, 500], [*IDS, *range(400, 440)]]  # the last needs more padding than the others
    for decoder in (Autoregressive(network), Parallel(network)):
        alone = [decoder(image, ids) for image, ids in zip(pixels, prompts, strict=True)]
        assert np.allclose(decoder.together(pixels, prompts), alone, atol=1e-5)
    words = greedy_tokens(network, torch.from_numpy(pixels[:1]), torch.tensor([IDS]), torch.tensor([len(IDS)]))
    assert words.tolist() == [Autoregressive(network).tokens(pixels[0], IDS).tolist()]


def test_fused_products_answer_the_same_in_every_way(network):
    """Words and chunks, alone and together, with keys and values that several heads share, and with padding."""
    config = tiny_config(chunk=3)
    shared = replace(config.language, num_key_value_heads=config.language.num_attention_heads // 2)
    pixels = np.concatenate([some_pixels(seed) for seed in range(2)])
    prompts = [IDS, [*IDS, *range(400, 440)]]
    for made in (copy.deepcopy(network), random_network(replace(config, language=shared), seed=2)):
        decoders = [Autoregressive(made), Parallel(made)]
        wanted = [decode.together(pixels, prompts) for decode in decoders]
        fuse(made.language_model.model.layers)
        for decode, answers in zip(decoders, wanted, strict=True):
            assert np.allclose(decode.together(pixels, prompts), answers, atol=1e-5)


def test_a_network_without_a_head_has_no_chunks():
    plain = random_network(tiny_config())
    with pytest.raises(ValueError, match="no action head"):
        Parallel(plain)
    with pytest.raises(ValueError, match="no action head"):
        plain.chunk_actions(torch.tensor([IDS]), torch.from_numpy(some_pixels()))


def test_a_prompt_without_room_is_refused(network):
    with pytest.raises(ValueError, match=r"3000 tokens; there is room for 1780"):
        Autoregressive(network).tokens(some_pixels()[0], [1] * 3000)


def batch():
    """Two rows of different length, padded at the right, with five labelled words each."""
    rows = [[*IDS, 31_800, 31_850, 31_900, 31_750, 2], [*IDS, 400, 29_871, 31_801, 31_851, 31_901, 31_751, 2]]
    longest = max(map(len, rows))
    ids = torch.tensor([row + [32_000] * (longest - len(row)) for row in rows])
    labels = torch.full_like(ids, IGNORED)
    for index, row in enumerate(rows):
        labels[index, len(row) - 5 : len(row)] = torch.tensor(row[-5:])
    return ids, torch.from_numpy(some_pixels(count=2)), (ids != 32_000).long(), labels


def test_the_loss_of_a_batch_is_the_mean_of_its_rows(network):
    ids, pixels, mask, labels = batch()
    together = network(ids, pixels, mask, labels).loss
    lengths = mask.sum(1).tolist()
    apart = [
        network(ids[i : i + 1, :n], pixels[i : i + 1], labels=labels[i : i + 1, :n]).loss for i, n in enumerate(lengths)
    ]
    assert together.item() == pytest.approx(float(np.mean([loss.item() for loss in apart])), abs=1e-4)


def test_the_labelled_words_are_scored_by_the_place_before_them(network):
    ids, pixels, mask, labels = batch()
    everything = network(ids, pixels, mask)
    scored = network(ids, pixels, mask, labels)
    assert scored.targets.tolist() == [31_800, 31_850, 31_900, 31_750, 2, 31_801, 31_851, 31_901, 31_751, 2]
    place = PATCHES + len(IDS) - 1
    assert torch.allclose(scored.logits[0], everything.logits[0, place], atol=1e-4)


def gradients(network):
    network.requires_grad_(True).train()
    ids, pixels, mask, labels = batch()
    network(ids, pixels, mask, labels).loss.backward()
    return {name: value.grad for name, value in network.named_parameters() if "action_head" not in name}


def test_checkpointing_changes_no_gradient(network):
    plain, checkpointed = copy.deepcopy(network), copy.deepcopy(network)
    checkpointed.enable_checkpointing()
    expected, found = gradients(plain), gradients(checkpointed)
    assert all(value is not None for value in expected.values())
    for name, value in expected.items():
        assert torch.allclose(found[name], value, rtol=1e-3, atol=1e-5), name


class TestCompiledBlocks:
    """By the eager backend, which runs what was traced: what is compiled, not by what."""

    @pytest.fixture(autouse=True)
    def nothing_is_compiled_yet(self):
        torch.compiler.reset()
        yield
        torch.compiler.reset()

    def test_blocks_share_their_code_however_many_there_are(self):
        graphs = []
        for layers in (2, 5):
            torch.compiler.reset()
            counters.clear()
            made = random_network(of_depth(tiny_config(), layers)).eval()
            decode, pixels = Autoregressive(made), some_pixels(1)[0]
            wanted = decode.tokens(pixels, IDS).tolist()
            compile_blocks(made, "eager")
            assert decode.tokens(pixels, IDS).tolist() == wanted
            graphs.append(counters["stats"]["unique_graphs"])
            uncompile(made)
            assert decode.tokens(pixels, IDS).tolist() == wanted
            assert counters["stats"]["unique_graphs"] == graphs[-1]
        assert graphs == [4, 4]  # a block of each tower, a layer for the prompt, a layer for a word

    def test_int8(self):
        made = random_network(of_depth(tiny_config(), 2)).eval()
        quantise(made.language_model.model.layers, "int8", "cpu")
        decode, pixels = Autoregressive(made), some_pixels(1)[0]
        wanted = decode.tokens(pixels, IDS).tolist()
        compile_blocks(made, "eager")
        assert decode.tokens(pixels, IDS).tolist() == wanted


def test_squares_are_prepared_beside_the_network_to_the_same_bits(network):
    frame = np.random.default_rng(3).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    preparation = ImagePreparation(means=((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)))
    seen = []

    def look(pixels, *_):
        seen.append(pixels)
        return pixels

    runner = Runner(look, network, preparation)
    runner(preparation.square(frame)[None], [IDS])
    assert np.array_equal(seen[0][0].numpy(), preparation.pixel_values(frame))
