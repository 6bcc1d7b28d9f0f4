"""What only a card can show: make test-card. It answers as the host does, also where it replays what it recorded."""

import numpy as np
import pytest
import torch

from cognitivedrone.models.openvla.compiled import compile_blocks
from cognitivedrone.models.openvla.config import tiny_config
from cognitivedrone.models.openvla.decode import Autoregressive, Parallel
from cognitivedrone.models.openvla.prepare import ImagePreparation
from cognitivedrone.models.openvla.weights import random_network

pytestmark = pytest.mark.card
IDS = [1, 512, 29_901, 1724, 3158, 881, 278, 29_871]


@pytest.fixture(autouse=True)
def exact_products() -> None:
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = False


def square(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (224, 224, 3), dtype=np.uint8)


@pytest.mark.parametrize("compiled", [False, True])
def test_words_and_actions_are_those_of_the_host(compiled: bool) -> None:
    host, there = (random_network(tiny_config(chunk=3), device, seed=1) for device in ("cpu", "cuda"))
    there.load_state_dict(host.state_dict())
    wanted = [Autoregressive(host).tokens(square(seed), IDS).tolist() for seed in range(4)]
    chunks = [Parallel(host)(square(seed), IDS) for seed in range(4)]
    if compiled:
        torch.compiler.reset()
        compile_blocks(there)
    words, actions = Autoregressive(there), Parallel(there)
    for _ in range(2):  # the second time from the recording alone
        assert [words.tokens(square(seed), IDS).tolist() for seed in range(4)] == wanted
        np.testing.assert_allclose([actions(square(seed), IDS) for seed in range(4)], chunks, atol=1e-4)


def test_squares_are_prepared_on_the_card_to_the_same_bits() -> None:
    from cognitivedrone.models.openvla.decode import Runner

    network = random_network(tiny_config(), "cuda")
    frame = np.random.default_rng(0).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    preparation = ImagePreparation()
    prepared = Runner(lambda pixels, *_: pixels, network)(preparation.square(frame)[None], [IDS])
    np.testing.assert_array_equal(prepared[0].numpy(), preparation.pixel_values(frame))


def test_too_little_memory_is_a_sentence() -> None:
    from cognitivedrone.errors import PolicyError
    from cognitivedrone.models.openvla.checkpoint import check_memory

    with pytest.raises(PolicyError, match="of GPU memory, has"):
        check_memory(10**13, torch.cuda.mem_get_info()[0], "cuda")
