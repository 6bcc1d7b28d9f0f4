"""A lesson: a user's pictures and sentences are taught, and what was known stays."""

import io
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from quick_trainings import SCHEDULE, train_here
from rich.console import Console

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.errors import LabelError, TaskError, TrainingError
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.training.language.problems import ABSENT, Mix, Problems
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.small_vla.export import load_trained
from cognitivedrone.training.teach.lesson import attribute_of, read_lesson, spoken
from cognitivedrone.training.teach.practice import LessonCrops, LessonProblems, varied
from cognitivedrone.training.teach.training import TEACH, TeachTraining, summary_of
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore
from cognitivedrone.training.trainer.training_task import Given, to_tensors

GATES = {str(i + 1): {"size": "big", "shape": "round", "color": c} for i, c in enumerate(("red", "green", "blue"))}
TINY = replace(TEACH, **SCHEDULE, steps_for_each=0, batch=16, validation_problems=16)

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


def task(prompt: str, *options: str) -> dict[str, object]:
    """A task whose first panel is right."""
    written = {"prompt": prompt, "prompt_simpler": "Fly through the big red round gate", "options": options}
    return {**written, "correct": 1, "gates": GATES, "background": "room"}


def picture(path: Path, color: tuple[int, int, int], size: tuple[int, int] = (90, 60)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, color).save(path)


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lesson") / "labels"
    picture(folder / "birds" / "robin.jpg", (200, 80, 40))
    picture(folder / "birds" / "robin_2.jpg", (180, 70, 50), (60, 90))
    picture(folder / "birds" / "blue-tit.png", (60, 90, 220))
    picture(folder / "birds" / "Wren.png", (120, 90, 60))
    picture(folder / "tools" / "hammer.png", (90, 90, 90))
    picture(folder / "food" / "healthy_1.png", (20, 200, 20))
    picture(folder / "food" / "healthy_2.png", (40, 220, 20))
    picture(folder / "food" / "unhealthy_1.png", (220, 200, 120))
    picture(folder / "food" / "unhealthy_2.png", (200, 180, 120))
    return folder


@pytest.fixture(scope="module")
def tasks(labels: Path) -> Path:
    path = labels.parent / "food.json"
    prompt = "Fly to the gate with healthy food"
    written = [task(prompt, f"healthy_{1 + i % 2}", "unhealthy_1", "unhealthy_2") for i in range(3)]
    path.write_text(json.dumps(written))
    return path


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("robin_2", "robin"),
        ("blue-tit", "blue tit"),
        ("Healthy/healthy_13", "healthy"),
        ("cheetahdae", "cheetah"),
        ("Ada Lovelace", "ada lovelace"),
        ("7", "7"),
        ("A", "a"),
    ],
)
def test_a_file_is_named_as_one_says_it(file: str, said: str) -> None:
    assert spoken(file) == said


@pytest.mark.parametrize(
    ("reference", "name"),
    [
        ("Digits/seven", "concept/number:7"),
        ("Digits/7", "concept/number:7"),
        ("signs/B", "concept/letter:B"),
        ("pets/cat", "concept/thing:cat"),
        ("Logos/apple", "concept/logo:apple"),
        ("fruit/apple", "concept/thing:apple"),
        ("birds/Blue-Tit", "concept/thing:blue_tit"),
    ],
)
def test_what_is_known_keeps_its_name(reference: str, name: str) -> None:
    assert attribute_of(reference) == name


def test_a_lesson_is_what_the_folder_shows_and_the_tasks_say(labels: Path, tasks: Path) -> None:
    lesson = read_lesson(labels, tasks)
    assert set(lesson.names) == {
        f"concept/thing:{name}" for name in ("robin", "blue_tit", "wren", "hammer", "healthy", "unhealthy")
    }
    assert len(lesson.pictures["concept/thing:robin"]) == 2
    assert "concept/thing:hammer" not in lesson.new(AttributeIndex().schema.names)
    named = next(each for each in lesson.statements if each.true == ("concept/thing:wren",))
    assert set(named.false) == {"concept/thing:robin", "concept/thing:blue_tit"}
    assert len(lesson.tasks) == 3


def test_what_is_taught_again_is_said(labels: Path) -> None:
    told = summary_of(read_lesson(labels), AttributeIndex().schema.names)
    assert told == "6 concepts in 9 pictures; known already and taught again: hammer"


def test_a_sentence_of_tasks_holds_for_what_was_right_and_not_for_what_never_was(tmp_path: Path) -> None:
    for name in ("kale", "plum", "chips", "fudge"):
        picture(tmp_path / "food" / f"{name}.png", (9, 9, 9))
    rows = [("kale", "chips", "fudge"), ("plum", "fudge", "chips")]
    written = [task("Fly to the gate with what grows", *row) for row in rows]
    (tmp_path / "food.json").write_text(json.dumps(written))
    lesson = read_lesson(tmp_path, tmp_path / "food.json")
    (statement,) = (each for each in lesson.statements if each.sentences)
    assert statement.phrases == ("what grows",)
    assert statement.true == ("concept/thing:kale", "concept/thing:plum")
    assert statement.false == ("concept/thing:chips", "concept/thing:fudge")


def test_a_table_beside_the_pictures_says_who_is_who(tmp_path: Path) -> None:
    for name in ("ada", "grace-hopper", "alan", "kurt"):
        picture(tmp_path / "colleagues" / f"{name}.png", (9, 9, 9))
    before = read_lesson(tmp_path)
    (tmp_path / "facts.csv").write_text(
        "concept,department,remote\nada,sales,yes\nGrace Hopper,navy,no\nalan,lab,yes\ncolleagues/kurt,lab,no\n"
    )
    lesson = read_lesson(tmp_path)
    assert lesson.digest != before.digest
    found = {each.phrases[0]: each for each in lesson.statements if not each.by_name}
    sales = found["the sales one"]
    assert sales.true == ("concept/thing:ada",)
    assert sales.false == ("concept/thing:alan", "concept/thing:grace_hopper", "concept/thing:kurt")
    assert "the one that is not remote" in found
    assert lesson.notes()["concept/thing:ada"].startswith("the sales one; ")
    assert "the lab one" in found
    assert f"{lesson.facts} statements from facts.csv" in summary_of(lesson, ())
    rng = np.random.default_rng(0)
    problems = LessonProblems(lesson, Problems(Mix()), 1.0)
    asked = [problem for _ in range(400) for problem in problems.draw(rng) if "sales" in problem.sentence.lower()]
    assert asked
    assert all(p.target == ABSENT or p.labels[p.target] == "taught/concept/thing:ada" for p in asked)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("concept,a\nnobody,x\n", "no picture of 'nobody'"),
        ("name,a\nada,x\n", "concept"),
        ("concept\nada\n", "only the column concept"),
        ("concept,class\nada,greenish-grue\n", "is not in the table"),
        ("", "empty"),
    ],
)
def test_a_bad_table_is_refused_before_any_training(tmp_path: Path, table: str, said: str) -> None:
    for name in ("ada", "alan"):
        picture(tmp_path / "colleagues" / f"{name}.png", (9, 9, 9))
    (tmp_path / "facts.csv").write_text(table)
    with pytest.raises(TaskError, match=said):
        read_lesson(tmp_path)


def test_a_table_that_is_a_link_to_nothing_is_not_passed_over(tmp_path: Path) -> None:
    for name in ("ada", "alan"):
        picture(tmp_path / "colleagues" / f"{name}.png", (9, 9, 9))
    (tmp_path / "facts.csv").symlink_to("moved.csv")
    with pytest.raises(TaskError, match=r"cannot read .*facts\.csv"):
        read_lesson(tmp_path)


def test_names_that_collide_are_said_and_asked_for_with_their_kind(tmp_path: Path) -> None:
    for path in ("logos/apple.png", "fruit/apple.png", "fruit/red.png"):
        picture(tmp_path / path, (9, 9, 9))
    with pytest.warns(UserWarning, match="apple: one name|red: also") as warned:
        lesson = read_lesson(tmp_path)
    told = [str(each.message) for each in warned]
    assert any(text.startswith("apple: one name, several concepts") for text in told)
    assert any(text.startswith("red: also a look of gates") for text in told)
    said = {phrase for each in lesson.statements for phrase in each.phrases}
    assert {"apple of fruit", "the logo apple"} <= said
    assert not said & {"apple", "the apple"}


def test_bad_lessons_are_refused_before_any_training(tmp_path: Path, labels: Path) -> None:
    picture(tmp_path / "one" / "birds" / "robin.png", (9, 9, 9))
    with pytest.raises(TrainingError, match=r"shows 1 concept\(s\)"):
        read_lesson(tmp_path / "one")
    picture(tmp_path / "broken" / "birds" / "robin.png", (9, 9, 9))
    (tmp_path / "broken" / "birds" / "wren.png").write_bytes(b"no picture")
    with pytest.raises(LabelError, match=r"wren\.png cannot be read"):
        read_lesson(tmp_path / "broken")
    with pytest.raises(TrainingError, match="needs --labels"):
        TEACH.training(Given())
    (tmp_path / "food.json").write_text(json.dumps([task("Fly", "x", "y", "z")]))
    with pytest.raises(TrainingError, match="none of the 1 tasks can be shown"):
        read_lesson(labels, tmp_path / "food.json")


def test_tasks_without_their_pictures_are_left_out_and_said(labels: Path, tasks: Path, tmp_path: Path) -> None:
    more = [*json.loads(tasks.read_text()), task("Fly", "x", "y", "z")]
    (tmp_path / "food.json").write_text(json.dumps(more))
    with pytest.warns(UserWarning, match="1 of 4 tasks are left out"):
        assert len(read_lesson(labels, tmp_path / "food.json").tasks) == 3


def test_problems_of_a_lesson_have_one_right_gate(labels: Path, tasks: Path) -> None:
    lesson = read_lesson(labels, tasks)
    problems = LessonProblems(lesson, Problems(Mix()), share=1.0)
    rng = np.random.default_rng(0)
    drawn = [problem for _ in range(300) for problem in problems.draw(rng)]
    assert {problem.target for problem in drawn} == {0, 1, 2, ABSENT}
    for problem in drawn:
        shown = [label.removeprefix("taught/") for label in problem.labels]
        if problem.target != ABSENT and "healthy" not in problem.sentence.lower():
            assert shown.count(shown[problem.target]) == 1


def test_crops_of_a_lesson_show_it_and_what_was_known(labels: Path) -> None:
    lesson = read_lesson(labels)
    names = AttributeIndex().schema.names
    end = AttributeIndex().groups["concept"].stop
    index = AttributeIndex((*names[:end], *lesson.new(names), *names[end:]))
    crops = LessonCrops(lesson, index, 32)
    images, attributes = crops.draw(np.random.default_rng(0), 20, 1.0)
    assert images.shape == (20, 32, 32, 3)
    concept = attributes[:, index.column("concept")]
    assert {index.schema.names[value] for value in concept} <= set(lesson.names)
    _, mixed = crops.draw(np.random.default_rng(0), 20, 0.5)
    assert (mixed[:, index.column("kind")] >= 0).all()
    small = varied(Image.new("RGB", (300, 40), "red"), np.random.default_rng(1), mirror=True)
    assert small.size == (64, 64)


@pytest.fixture(scope="module")
def pilot(policy_file: Path, reasoner_parts: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny pilot."""
    folder = tmp_path_factory.mktemp("pilot")
    for path in (*policy_file.parent.glob("*.onnx"), reasoner_parts / "gate_selector.onnx"):
        shutil.copy(path, folder)
    return folder


@pytest.fixture(scope="module")
def training(pilot: Path, labels: Path, tasks: Path) -> TeachTraining:
    return TINY.training(Given(start=pilot, labels=labels, tasks=tasks))


@pytest.fixture(scope="module")
def taught(training: TeachTraining, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the taught pilot."""
    folder = tmp_path_factory.mktemp("taught")
    training.export(train_here(folder, training), folder)
    return folder


def test_a_grown_pilot_answers_as_before_until_it_is_taught(training: TeachTraining, pilot: Path) -> None:
    before, start = load_trained(pilot / "model.onnx")
    grown = training.network().eval()
    crops = torch.rand(4, 3, 32, 32)
    assert before.reader is not None
    assert grown.reader is not None
    rows = [training.names.index(name) for name in before.schema.names]
    with torch.no_grad():
        torch.testing.assert_close(grown.reader(crops)[:, rows], before.reader(crops))
        new = [row for row in range(len(training.names)) if row not in rows]
        assert len(new) == 5
        assert (grown.reader(crops)[:, new].mean() < before.reader(crops).mean()).item()
        # Understood by name: a new value begins with the meaning of its name, as long as those that were known.
        assert before.language is not None
        assert grown.language is not None
        torch.testing.assert_close(grown.language.prototypes[rows], before.language.prototypes)
        length = before.language.prototypes.norm(dim=-1).mean()
        torch.testing.assert_close(grown.language.prototypes[new].norm(dim=-1), length.expand(len(new)))
        words = torch.from_numpy(start.encoder().words("blue tit")).mean(0)
        blue_tit = training.names.index("concept/thing:blue_tit")
        alike = torch.nn.functional.cosine_similarity(
            grown.language.prototypes[new], torch.nn.functional.normalize(words, dim=-1)[None]
        )
        assert new[int(alike.argmax())] == blue_tit
        query, _ = before.language(words[None, None], torch.zeros(1, len(rows)), torch.zeros(1))
        torch.testing.assert_close(grown.language.scores(query)[:, rows], before.language.scores(query))


def test_only_what_a_lesson_is_about_changes(taught: Path, training: TeachTraining) -> None:
    before = training.network()
    after = training.network()
    restore(read_checkpoint(taught / "checkpoint.safetensors")[0], after, None)
    changed = {
        name
        for (name, value), other in zip(before.state_dict().items(), after.state_dict().values(), strict=True)
        if not torch.equal(value, other)
    }
    assert changed
    assert not any("running_" in name for name in changed)
    assert {name.partition(".")[0] for name in changed} == {"reader", "language"}


def test_a_taught_pilot_is_flown_and_taught_again(taught: Path, labels: Path) -> None:
    model = SmallModel.load(taught / "model.onnx")
    assert "concept/thing:robin" in model.description.attributes
    reasoner = SmallReasoner(taught)
    assert "concept/thing:blue_tit" in reasoner.attributes.names
    assert reasoner.mind.attributes == reasoner.attributes
    assert {path.name for path in taught.glob("*.onnx")} == {
        "model.onnx", "eyes.onnx", "gate_selector.onnx", "language.onnx", "text_encoder.onnx",
        "word_pieces.onnx",
    }  # fmt: skip
    assert reasoner.selector.notes == read_lesson(labels).notes()
    again = TINY.training(Given(start=taught, labels=labels))
    assert not again.lesson.new(again.policy.facts["attributes"])
    assert again.names == model.description.attributes


@pytest.mark.parametrize("page", ["docs/training.md", "docs/tutorials/train.md"])
def test_the_commands_of_the_pages_fly_the_taught_pictures(
    page: str, taught: Path, labels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page's own lines, where its own folders are: what `train` is told to write is what `fly` is told to read."""
    text = (Path(__file__).parents[2] / page).read_text().replace("\\\n", " ")
    commands = [shlex.split(line) for line in text.splitlines() if line.startswith("cognitivedrone")]
    (lesson,) = (words for words in commands if words[1:4] == ["train", "--recipe", "teach"])
    flights = [words for words in commands if words[1] == "fly" and "--policy" in words]
    monkeypatch.chdir(tmp_path)
    (tmp_path / option(lesson, "--labels")).symlink_to(labels)
    (tmp_path / option(lesson, "--out")).parent.mkdir()
    (tmp_path / option(lesson, "--out")).symlink_to(taught)
    assert option(lesson, "--recipe") == "teach"
    for words in flights:
        plan = FlyPlan.of(film=False,
            instruction=words[-1], policy=option(words, "--policy"), reasoner=option(words, "--reasoner"),
            labels=option(words, "--labels"), out=Path("flight"), time_limit=2.0,
        )  # fmt: skip
        summary = fly_mission(plan, console=Console(file=io.StringIO()), keyboard=io.StringIO(), pace="lockstep")
        (shown,) = summary.track
        concept = words[-1].rpartition(" the ")[2]
        assert [concept in label for label in shown.labels] == [gate == shown.target for gate in range(3)]
        assert {label.partition("/")[0] for label in shown.labels} <= {path.name for path in labels.iterdir()}
        assert summary.steps > 0
    assert flights


def option(words: list[str], name: str) -> str:
    """The value of an option of a command line."""
    return words[words.index(name) + 1]


def test_the_loss_of_a_lesson_falls_where_it_is_learnt(training: TeachTraining) -> None:
    torch.manual_seed(0)
    loss_module = training.loss_module(training.network())
    loss_module.train()
    batch = to_tensors(next(training.batches()((0, 0, 0))))
    optimizer = torch.optim.AdamW(loss_module.parameters(), 3e-3)
    losses = []
    for _ in range(12):
        loss, _ = loss_module(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.8 * losses[0]
