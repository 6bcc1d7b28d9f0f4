"""The benchmark of OpenVLA on a GPU, on the tiny networks: that each path runs, and measures what it says."""

import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")
pytest.importorskip("peft")

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import openvla_gpu  # noqa: E402
import openvla_gpu_lora as lora  # noqa: E402
from openvla_gpu_report import Machine, Report  # noqa: E402

from cognitivedrone.benchmark.measurements import read_measurement  # noqa: E402

HOST = Machine("cpu", torch.float32, "no GPU here")

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.slow
def test_every_path_runs_and_leaves_a_table(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(openvla_gpu, "find_machine", lambda: HOST)
    monkeypatch.setattr(lora, "STEPS", 3)
    out = tmp_path / "openvla_gpu.json"
    openvla_gpu.main(["--steps", "1", "--lora", "--out", str(out)])
    made = read_measurement(out)
    assert "no GPU here" in made.machine
    assert made.versions["torch"] == torch.__version__
    assert "nothing about the 7B" in made.note
    assert made.command == "python benchmarks/openvla_gpu.py --steps 1 --lora"
    assert len({row["table"] for row in made.rows}) == 2
    names = [row["row"] for row in made.rows]
    assert len(names) == len({*names}) == 12
    assert "not measured" not in out.read_text()
    assert all(name in capsys.readouterr().out for name in names[:1])


def test_a_row_that_fails_is_told_of_and_the_rest_goes_on(tmp_path):
    report = Report(HOST, tmp_path / "some.json")
    report.table("Some", "number")
    with report.measuring("first"):
        raise RuntimeError("no\nkernel")
    with report.measuring("second"):
        raise torch.OutOfMemoryError
    with report.measuring("third"):
        report.row("third", "3")
    assert [row["number"] for row in read_measurement(tmp_path / "some.json").rows] == [
        "not measured: RuntimeError no kernel",
        "does not fit",
        "3",
    ]


def test_the_published_loop_computes_the_same_loss():
    network, trained = lora.adapted(HOST)
    batch = lora.some_batch(network, 3)
    assert len(set(batch[2].sum(1).tolist())) > 1  # some rows have padding
    network.language_model.set_attn_implementation("eager")
    published = lora.published_loss(network, batch)
    network.language_model.set_attn_implementation("sdpa")
    ours = lora.our_loss(network, batch)
    assert published.item() == pytest.approx(ours.item(), rel=1e-5)
    assert all(value.dtype == torch.float32 for value in trained)
