"""Frames by number of contexts and of processes, in small; a process that cannot draw does not hold up the others."""

import sys
import threading
from pathlib import Path
from queue import SimpleQueue

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import rendering_contexts

from cognitivedrone.benchmark.measurements import read_measurement
from cognitivedrone.errors import RenderError


def test_contexts_and_processes_leave_a_row_each(tmp_path, capsys):
    out = tmp_path / "rendering.json"
    rendering_contexts.main(["--rounds", "1", "--most", "1", "--processes", "1", "--out", str(out)])
    one, process = read_measurement(out).rows
    assert one["contexts"] == process["processes"] == 1
    assert one["frames_per_s"] > 0
    assert process["frames_per_s"] > 0
    assert process["lost"] == 0
    assert " 1 processes" in capsys.readouterr().out


def test_a_process_without_a_first_frame_lets_the_others_draw(monkeypatch, capsys):
    rate = iter([RenderError("the card drew no frame within 60 s"), 100.0])

    def frame_rate(*_, ready, **__):
        if isinstance(found := next(rate), Exception):
            raise found
        ready()
        return found

    monkeypatch.setattr(rendering_contexts, "frame_rate", frame_rate)
    gate, rates = threading.Barrier(2), SimpleQueue()
    for _ in range(2):
        rendering_contexts.draw(gate, rates, 1)
    assert rates.get() == 100.0
    assert rates.empty()
    assert "drew no frame" in capsys.readouterr().out
