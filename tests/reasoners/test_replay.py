import json
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.errors import PolicyError, ReasonerError
from cognitivedrone.reasoners import make_reasoner, replay
from cognitivedrone.reasoners.replay import FAULTS, Replay
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import DroneState, EpisodeContext, GroundTruth, Guidance, Stage

FIRST, SECOND, THIRD = (task for (task,) in load_suite("open-v1:test").tracks[:3])
IMAGE = np.zeros((256, 256, 3), np.uint8)


def context_of(task) -> EpisodeContext:
    def state() -> DroneState:
        raise AssertionError("a replay has no use for the drone's state")

    return EpisodeContext(task.instruction, ground_truth=GroundTruth(task, Stage(task.gates, task.labels), state))


def written(path: Path, *objects: dict) -> str:
    path.write_text("".join(json.dumps(obj) + "\n" for obj in objects))
    return str(path)


def test_answers_come_one_after_the_other_and_the_last_one_stays(tmp_path):
    lines = [
        {"task": FIRST.id, "directive": "Fly through the red gate", "gate": 0, "confidence": 0.4},
        {"task": SECOND.id, "directive": "Go left", "gate": None, "confidence": 1, "fault": None, "seconds": 3},
        {"task": FIRST.id, "directive": "Fly through the blue gate", "gate": 2, "confidence": 0.9},
    ]
    reasoner = Replay(written(tmp_path / "answers.jsonl", *lines))
    assert reasoner.needs_ground_truth
    for _ in range(2):
        reasoner.reset(context_of(FIRST))
        assert reasoner.refine(IMAGE, "") == Guidance("Fly through the red gate", 0, 0.4)
        for _ in range(3):
            assert reasoner.refine(IMAGE, "") == Guidance("Fly through the blue gate", 2, 0.9)
        reasoner.reset(context_of(SECOND))
        assert reasoner.refine(IMAGE, "") == Guidance("Go left", None, 1.0)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_is_raised_as_it_was_and_the_next_answer_follows(tmp_path, kind):
    lines = [{"task": FIRST.id, "fault": kind}, {"task": FIRST.id, "directive": "Fly through the red gate"}]
    reasoner = Replay(written(tmp_path / "answers.jsonl", *lines))
    reasoner.reset(context_of(FIRST))
    with pytest.raises(ReasonerError) as fault:
        reasoner.refine(IMAGE, "")
    assert fault.value.kind == kind
    assert reasoner.refine(IMAGE, "").directive == "Fly through the red gate"


def test_a_task_that_the_file_does_not_have_gets_no_answer(tmp_path):
    reasoner = Replay(written(tmp_path / "answers.jsonl", {"task": FIRST.id, "directive": "Go left"}))
    reasoner.reset(context_of(THIRD))
    with pytest.raises(ReasonerError, match=f"answers.jsonl has no answer for task '{THIRD.id}'") as fault:
        reasoner.refine(IMAGE, "")
    assert fault.value.kind == "unsure"


def test_it_needs_to_be_told_the_task(tmp_path):
    reasoner = Replay(written(tmp_path / "answers.jsonl", {"task": FIRST.id, "directive": "Go left"}))
    with pytest.raises(PolicyError, match="needs the simulator's ground truth"):
        reasoner.refine(IMAGE, "")


def test_empty_lines_and_odd_line_separators_are_read(tmp_path):
    file = tmp_path / "answers.jsonl"
    line = json.dumps({"task": FIRST.id, "directive": "Go\u2028left"}, ensure_ascii=False)
    file.write_bytes(f"\r\n{line}\r\n\n".encode())
    reasoner = Replay(str(file))
    reasoner.reset(context_of(FIRST))
    assert reasoner.refine(IMAGE, "").directive == "Go\u2028left"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("<html>", "is not JSON; every line must be one object"),
        ("[" * 100_000, "is not JSON"),
        ('{"task": 7, "directive": "Go left"}', "must be an object with a task's id"),
        ('{"task": "a"}', "directive must be a sentence, not None, or fault say why"),
        ('{"task": "a", "directive": "x", "gate": 3}', "gate is 3; it must be 0, 1 or 2"),
        ('{"task": "a", "directive": "x", "gate": true}', "gate is True"),
        ('{"task": "a", "directive": "x", "confidence": 1.5}', r"confidence is 1\.5; it must be a number from 0 to 1"),
        ('{"task": "a", "directive": "x", "confidence": NaN}', "confidence is nan"),
        ('{"task": "a", "fault": "timout"}', r"unknown fault 'timout'; did you mean 'timeout'\?"),
        ('{"task": "a", "fault": ["timeout"]}', "unknown fault"),
    ],
)
def test_a_bad_line_is_reported_with_file_and_number(tmp_path, line, message):
    file = tmp_path / "answers.jsonl"
    good = json.dumps({"task": FIRST.id, "directive": "Go left"})
    file.write_bytes(f"{good}\n\n{line}\n".encode(errors="surrogateescape"))
    with pytest.raises(PolicyError, match=rf"answers\.jsonl line 3\b.*{message}"):
        Replay(str(file))


def test_a_file_that_is_no_text_is_reported_with_the_line(tmp_path):
    file = tmp_path / "answers.jsonl"
    file.write_bytes(b"{}\n\n\xff\n")
    with pytest.raises(PolicyError, match=r"answers\.jsonl cannot be read: it is not UTF-8 text \(line 3\)"):
        Replay(str(file))


def test_a_file_that_cannot_be_is_reported(tmp_path, monkeypatch):
    with pytest.raises(PolicyError, match="needs path; write replay:PATH"):
        make_reasoner("replay")
    with pytest.raises(PolicyError, match=r"there is no file .*missing\.jsonl"):
        Replay(str(tmp_path / "missing.jsonl"))
    with pytest.raises(PolicyError, match="there is no file"):
        Replay(str(tmp_path))
    with pytest.raises(PolicyError, match="holds no answer"):
        Replay(written(tmp_path / "empty.jsonl"))
    monkeypatch.setattr(replay, "MAX_FILE_BYTES", 1 << 20)
    (tmp_path / "large.jsonl").write_bytes(b"\n" * ((1 << 20) + 1))
    with pytest.raises(PolicyError, match=r"large\.jsonl cannot be read: it has 1,048,577 bytes"):
        Replay(str(tmp_path / "large.jsonl"))
