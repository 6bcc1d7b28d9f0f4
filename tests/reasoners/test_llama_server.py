"""The reasoner `vlm` against llama.cpp's own server with real weights, where somebody gives them (CONTRIBUTING.md)."""

import json
import os
import re
import urllib.request
from collections.abc import Iterator

import numpy as np
import pytest

from cognitivedrone.errors import ReasonerError
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.vlm import Vlm

WEIGHTS = "COGNITIVEDRONE_TEST_GGUF"
pytestmark = pytest.mark.usefixtures("no_vlm_settings")


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    if not (weights := os.environ.get(WEIGHTS)):
        pytest.skip(f"no weights: name the GGUF file of a language model in {WEIGHTS}")
    xllamacpp = pytest.importorskip("xllamacpp", reason="llama.cpp's server is not installed (pip install xllamacpp)")
    params = xllamacpp.CommonParams()
    params.model.path, params.n_ctx, params.n_parallel, params.warmup, params.port = weights, 4096, 1, False, 0
    server = xllamacpp.Server(params)
    yield f"{server.listening_address}/v1"
    del server


@pytest.fixture
def vlm(url: str) -> Iterator[Vlm]:
    with urllib.request.urlopen(f"{url}/models") as listed:  # noqa: S310
        model = json.load(listed)["data"][0]["id"]
    made = make_reasoner(f"vlm:{url},model={model},timeout=300")
    assert isinstance(made, Vlm)
    yield made
    made.close()


def test_the_server_is_found_and_plans_a_mission_by_the_schema(vlm):
    vlm.check()
    said = ""
    try:
        said = " ".join(goal.kind for goal in vlm.plan("first the cat, then the dog, then land on the blue pad"))
    except ReasonerError as error:  # a small model may plan what cannot be flown; that is an answer, too
        said = f"{error.kind}: {error}"
    assert re.fullmatch(r"(?:fly|if|land)(?: (?:fly|if|land))*|schema: .*plan.*", said)


def test_a_model_without_eyes_refuses_frames_in_its_own_words(vlm):
    says = r"image|mmproj|multimodal"
    with pytest.warns(RuntimeWarning, match=says), pytest.raises(ReasonerError, match=says):
        vlm.refine(np.zeros((256, 256, 3), np.uint8), "the dog")
