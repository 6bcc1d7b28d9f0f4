"""The published benchmark from files of its form: flown, read from recordings, answered as the paper's reasoner did."""

import json
import shutil

import numpy as np
import pytest
from made_once import made_once
from openvla_files import write_checkpoint
from published_checkout import make_checkout_with_flights, turn_to_gate
from typed_commands import typed

from cognitivedrone.benchmark.config import Plan, PredictPlan, ReasonPlan
from cognitivedrone.benchmark.open_loop import predict
from cognitivedrone.benchmark.reasoning.reason import score_reasoner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.data.formats.published import agreement
from cognitivedrone.data.recorded import recorded
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError, LabelError, PluginError, RunError
from cognitivedrone.reasoners import make_reasoner


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    return made_once(tmp_path_factory, "checkout", make_checkout_with_flights) / "checkout"


@pytest.fixture
def copy(checkout, tmp_path):
    return shutil.copytree(checkout, tmp_path / "copy")


def plan(checkout, **options):
    return Plan.of(**{"tasks": checkout / "Validation", "labels": checkout, "policy": "oracle"} | options)


def test_all_tasks_are_flown_and_shown_beside_the_papers(checkout, tmp_path):
    sources = f"--tasks {checkout}/Validation --labels {checkout}/model_for_data_collection"
    command = f"bench {sources} --policy colour_seeker --reasoner oracle --workers 0 --clips 1 --out run"
    said = typed(command.split(), tmp_path)
    assert "passes 24 of 24 tasks of Validation" in " ".join(said.split())
    assert "CognitiveDrone-R1 76.8 (64-86) 78.9 (70-86) 75.9 (63-85) 77.2 (71-82)" in " ".join(said.split())
    document = json.loads((tmp_path / "run/results.json").read_text())
    rows = {row["name"]: row for row in document["paper"]}
    assert [*rows] == ["human_recognition", "symbol_understanding", "reasoning", "average"]
    assert (rows["symbol_understanding"]["n"], rows["average"]["rate"]) == (12, 1)
    assert rows["average"]["paper"]["CognitiveDrone"] == 0.596
    assert "on these tasks" in (tmp_path / "run/report.html").read_text()
    assert read_results(tmp_path / "run").summary().overall.passed == 24


def test_tasks_without_a_picture_are_named_at_once_and_left_out_on_a_word(copy):
    (copy / "model_for_data_collection/Reasoning/Logos/apple.jpg").unlink()
    (copy / "model_for_data_collection/Reasoning/Logos/apple.dae").unlink()
    letter = copy / "model_for_data_collection/Reasoning/Letters/T.jpg"
    letter.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    with pytest.raises(LabelError) as refused:
        resolve(plan(copy))
    assert "6 of 24 tasks of Validation lack a picture" in str(refused.value)
    assert "known: amazon, netflix" in str(refused.value)
    assert "git lfs pull" in str(refused.value)
    job = resolve(plan(copy, missing="skip"))
    assert (job.facts.suite.size, job.facts.suite.asked) == (18, 24)
    assert job.facts.suite.left_out == "18 of 24 tasks; the others lack a picture"


def test_without_labels_the_way_out_is_said(checkout):
    with pytest.raises(LabelError, match=r"24 of 24 tasks .* add --labels FOLDER"):
        resolve(plan(checkout, labels=None))


def test_the_papers_reasoner_is_matched_by_the_task(checkout, tmp_path):
    for place in (checkout, checkout / "eval_after_reasoning/after_reasoning"):
        assert len(make_reasoner(f"published:{place}").answers) == 24
    digests = {
        name: resolve(plan(checkout, reasoner=f"published:{name}")).facts.options["reasoner_model"]
        for name in (checkout, checkout / "eval_after_reasoning")
    }
    assert len(set(digests.values())) == 2
    results = score_reasoner(
        ReasonPlan.of(flights=checkout, reasoner=f"published:{checkout}", out=tmp_path / "said"), progress=False
    )
    assert results.summary.overall.right == results.summary.overall.n == 8
    with pytest.raises(PluginError, match=r"holds no <Type>_updated\.json"):
        make_reasoner(f"published:{checkout / 'model_for_data_collection'}")


def test_a_reasoner_reads_recorded_first_frames_or_every_nth(checkout, tmp_path):
    first = score_reasoner(ReasonPlan.of(flights=checkout, reasoner="small", out=tmp_path / "first"), progress=False)
    assert first.summary.overall.right >= 6
    assert {answer.frame for answer in first.answers} == {0}
    assert json.loads((tmp_path / "first/reason.json").read_text())["options"]["flights"] == "checkout"
    many = score_reasoner(
        ReasonPlan.of(flights=checkout, every=20, episodes=2, reasoner="oracle", out=tmp_path / "many"), progress=False
    )
    assert [answer.frame for answer in many.answers if answer.episode == 0][:2] == [0, 20]
    with pytest.raises(DataError, match=r"no <Type>/<episode>/setup\.json below"):
        score_reasoner(ReasonPlan.of(flights=checkout / "model_for_data_collection", out=tmp_path / "none"))


def test_imported_flights_are_shown_replayed_and_their_actions_checked(checkout, tmp_path):
    said = typed(["data", "import", str(checkout), "--from", "published", "--out", "set"], tmp_path)
    assert "8 episodes" in said
    assert "in 8 of 8 flights dx, dy, dz and angle follow from the poses" in said
    assert "human recognition" in typed(["data", "show", "set"], tmp_path)
    assert "steps, ends" in typed(["data", "replay", "set", "1"], tmp_path)
    for form in ("rlds", "lerobot"):
        typed(["data", "export", "set", "--to", form, "--out", form], tmp_path)


def test_a_flight_whose_action_turns_to_another_gate_is_named(copy):
    setups = sorted(copy.glob("Validation/**/setup.json"))
    target = json.loads(setups[0].read_text())["correct"]
    turn_to_gate(setups[0].parent, (4.0, -4.0) if target != 3 else (5.0, 0.0))
    said = agreement(copy)
    assert "in 7 of 8 flights" in said
    assert f"{setups[0].parent} (its angle points to gate {3 if target != 3 else 2})" in said


def test_a_policy_is_scored_open_loop_by_category(checkout, tmp_path):
    flights = recorded(checkout)
    assert len(flights) == 8
    scores = predict(PredictPlan(flights=checkout, policy="oracle", out=tmp_path / "oracle.json"))
    assert {"overall", "human_recognition", "symbol_understanding", "reasoning"} == scores.keys()
    assert scores["overall"].l1[3] < 0.25
    assert scores["overall"].cross_entropy is None
    hovering = predict(PredictPlan(flights=checkout, policy="hover", every=7, out=tmp_path / "hover.json"))
    speeds = np.concatenate([np.abs(flight.load().action[::7]) for flight in flights])
    np.testing.assert_allclose(hovering["overall"].l1, speeds.mean(axis=0), atol=1e-6)
    with pytest.raises(RunError, match="no flight in its split val"):
        predict(PredictPlan(flights=checkout, split="val"))


def test_a_policy_of_tokens_is_scored_by_token(checkout, tmp_path):
    pytest.importorskip("torch")
    folder = write_checkpoint(tmp_path / "checkpoint")
    made = predict(
        PredictPlan(flights=checkout, policy=f"openvla:{folder}", episodes=1, every=20, out=tmp_path / "predict.json")
    )
    assert 5 < made["overall"].cross_entropy < 15  # of random weights: about the log of the vocabulary
    assert 0 <= made["overall"].accuracy <= 1


def test_a_store_is_read_by_split(checkout, tmp_path):
    store = Store.open(checkout.parent / "store")
    val = [each for each in recorded(store.path) if each.split == "val"]
    assert [each.load().index for each in val] == store.indices("val")
