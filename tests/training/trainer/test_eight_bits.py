"""A graph in integers computes what it did, and training gets its weights back."""

from importlib import import_module

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from cognitivedrone.training.small_vla.graph import write_onnx
from cognitivedrone.training.trainer.eight_bits import EIGHT, computing_in_eight_bits, weights_in


class _Network(nn.Module):
    def __init__(self, *, bias: bool) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, 8, 3, stride=2, padding=1, bias=bias)
        self.norm = nn.BatchNorm2d(8)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return torch.relu(self.norm(self.conv(image.permute(0, 3, 1, 2).float() / 255)))


def _graph(tmp_path, *, bias=False):
    torch.manual_seed(0)
    network = _Network(bias=bias).eval()
    network.norm.running_mean.uniform_(-0.2, 0.2)
    network.norm.running_var.uniform_(0.5, 2)
    network.norm.weight.data.uniform_(0.5, 2)
    path = tmp_path / "network.onnx"
    example = torch.zeros(2, 16, 16, 3, dtype=torch.uint8)
    write_onnx(network, {"image": example}, ("seen",), path, smaller=lambda _: None)
    return network, onnx.load(str(path))


def test_a_folded_graph_computes_as_before_and_its_weights_come_back(tmp_path):
    network, model = _graph(tmp_path)
    images = np.random.default_rng(0).integers(0, 256, (20, 16, 16, 3), dtype=np.uint8)
    computing_in_eight_bits(model, images)
    assert "BatchNormalization" not in {node.op_type for node in model.graph.node}
    path = tmp_path / "eight.onnx"
    onnx.save(model, str(path))
    (seen,) = import_module("onnxruntime").InferenceSession(str(path)).run(None, {"image": images[:1]})
    with torch.no_grad():
        exact = network(torch.from_numpy(images[:1])).numpy()
    np.testing.assert_allclose(seen, exact, atol=0.02 * exact.max())
    found = weights_in(model)
    weight = network.conv.weight.detach().numpy()
    integers = next(each for each in model.graph.initializer if each.name == f"conv.weight{EIGHT}")
    assert np.abs(onnx.numpy_helper.to_array(integers)).max() <= 64  # seven bits: no sum overflows without VNNI
    np.testing.assert_allclose(found["conv.weight"], weight, atol=np.abs(weight).max() / 60)
    np.testing.assert_array_equal(found["norm.running_var"], network.norm.running_var.numpy())


def test_a_bias_before_a_normalisation_is_refused(tmp_path):
    _, model = _graph(tmp_path, bias=True)
    with pytest.raises(ValueError, match="bias before its normalisation"):
        computing_in_eight_bits(model, np.zeros((1, 16, 16, 3), np.uint8))
