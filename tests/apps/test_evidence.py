"""A sentence without one word that the pilot knows is never flown; nor is one that only looks like known words."""

import json

import pytest
from app_fakes import flown

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.understanding.evidence import Evidence, taught_names
from cognitivedrone.apps.understanding.request import Understanding
from cognitivedrone.apps.understanding.scene import check_evidence, choose_scene, named_scene, plain_instruction
from cognitivedrone.errors import NotUnderstood
from cognitivedrone.policies.small import Small
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.tasks.format import task_to_json
from cognitivedrone.tasks.suites import load_suite

ENGLISH = frozenset(
    {"fly", "to", "the", "through", "gate", "with", "cat", "of", "that", "next", "please", "go", "a", "in"}
)
"""Words that a pilot knows whole."""
FOREIGN = (
    "飞过有猫的门",
    "穿过红色的门",
    "赤いゲートを通って",
    "고양이에게 날아가",
    "Пролети через красные ворота",
    "leć do bramki z kotem",
    "kediye doğru uç",
    "طر عبر البوابة الحمراء",
    "mene punaisen portin läpi",  # the last word but looks like a rabbit's
    "πέτα προς τη γάτα",
    "lennä kissan luo",
    "asdf qwer zxcv",
    "atraviesa donde corre",
    "!!!",
)


@pytest.mark.parametrize("sentence", FOREIGN)
def test_a_sentence_without_a_known_word_is_not_flown_and_the_known_language_is_named(sentence):
    evidence = Evidence(Understanding(real=ENGLISH))
    assert "the pilot knows English" in evidence.problem(sentence)
    assert plain_instruction(evidence, None, sentence) is None  # typed in flight, on a vehicle: it hovers
    with pytest.raises(NotUnderstood, match="the pilot knows English"):
        check_evidence(evidence, named_scene(load_suite("open-v1:smoke"), 0), sentence)
    with pytest.raises(NotUnderstood, match="the pilot knows English"):
        choose_scene(FlyPlan.of(film=False, instruction=sentence))


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("go", "go"),
        ("fly through the next gate please", "fly through the next gate please"),
        ("Fly to the cat", "Fly to the cat"),
        ("vuela hacia la puerta con el gato", "Fly through the gate with the cat"),
        ("gehe zum roten Tor", "Fly through the red gate"),
        ("attraversa la finestra", "Fly through the gate with the window"),
        ("catt", "Fly through the gate with the cat"),
        ("land", "land"),
        ("", ""),
    ],
)
def test_on_a_vehicle_the_pilot_is_told_what_it_knows(sentence, told):
    assert plain_instruction(Evidence(Understanding(real=ENGLISH)), None, sentence) == told


def test_what_names_nothing_known_is_not_flown_on_a_vehicle_either():
    evidence = Evidence(Understanding(real=ENGLISH))
    assert evidence.problem("fly to the frobnitz") == (
        "not understood: 'frobnitz'; say what to fly to, such as 'fly to the dog'"
    )
    assert "candle" in evidence.problem("fly to the chandelier")


def test_what_is_named_by_no_word_but_clearly_meant_gets_a_scene_and_nothing_else_does():
    evidence = Evidence(Understanding(real=Small().model.words), concepts=SmallReasoner().concepts)
    assert evidence.request("take me to where you keep milk cold").labels == {"food/milk"}
    assert evidence.request("head over to the thing firefighters drive").labels == {"object/fire_engine"}
    assert evidence.request("please fly to the animal that gives milk").labels == {"animal/cow"}
    assert evidence.request("something to do with music").labels == {"object/accordion"}
    assert "food/pizza" in evidence.request("I'm hungry").labels
    for sentence in (
        "take me to the Eiffel Tower",
        "kill all humans",
        "fly to the frobnitz",
        "through the gate with the unicorn",
        "what is the weather like",
    ):
        assert not evidence.request(sentence).understood
    assert plain_instruction(evidence, None, "coud you fly to the horse") == "coud you fly to the horse"
    assert plain_instruction(evidence, None, "pls fly to teh elefant :)") == "Fly through the gate with the elephant"
    assert plain_instruction(evidence, None, "the third gate") == "Fly through the right gate"
    assert plain_instruction(evidence, None, "the gate in the middle") == "the gate in the middle"
    assert plain_instruction(evidence, None, "what is 3 + 4?") == "what is 3 + 4?"


def test_taught_names_count_as_known_in_any_script():
    taught = taught_names(["concept/birds:blue_tit", "concept/x:zorgle", "concept/animal:猫", "kind/animal"])
    assert taught == {"blue tit", "zorgle", "猫"}
    evidence = Evidence(Understanding(taught=taught))
    assert not any(map(evidence.problem, ("zorgle", "por zorgle", "飞过有猫的门")))
    assert evidence.problem("飞过有狗的门")
    own = Understanding({"猫": frozenset({"animal/猫"})})
    assert own.understand("飞过有猫的门").labels == {"animal/猫"}


def test_a_pilot_that_may_read_other_languages_is_told_the_sentence_as_it_is():
    evidence = Evidence(Understanding(), english=False)
    assert plain_instruction(evidence, None, "飞过有猫的门") == "飞过有猫的门"
    assert not evidence.problem_of_task("飞过有猫的门")


def test_nothing_takes_off_over_mavlink(tmp_path):
    pytest.importorskip("pymavlink")
    from peer import playing

    with playing() as peer:
        with pytest.raises(NotUnderstood, match="the pilot knows English") as refused:
            flown(
                "arm\n", instruction="飞过有猫的门", link=f"mavlink:udpout:127.0.0.1:{peer.port}", camera="nowhere",
                policy="small", out=tmp_path / "f", i_understand_this_flies_a_real_drone=True,
            )  # fmt: skip
        assert not peer.received
    assert refused.value.exit_code == 3
    assert not (tmp_path / "f").exists()


def test_a_task_of_another_language_is_not_flown(tmp_path):
    task = task_to_json(load_suite("open-v1:smoke").tracks[0][0])
    text = json.dumps([task], ensure_ascii=False).replace(task["prompt"], "飞过有猫的门")
    file = tmp_path / "tasks.json"
    file.write_text(text, "utf-8")
    with pytest.raises(NotUnderstood, match="'飞过有猫的门' has no word that the pilot knows; the pilot knows English"):
        flown(tasks=file, episode=0, out=tmp_path / "f")
    assert not (tmp_path / "f").exists()


@pytest.mark.parametrize(
    ("sentence", "looks"),
    [
        ("a non-red gate", {"red"}), ("the dog, not the red one", {"red"}), ("any gate but blue", {"blue"}),
        ("through a gate that's neither red nor round", {"red", "round"}),
        ("not the red triangle", {"red triangle"}), ("nicht das rote Tor", {"red"}),
        ("the dog that is not red", set()), ("the woman without a red hat", set()), ("the red gate", set()),
    ],
)  # fmt: skip
def test_looks_that_a_sentence_denies_are_those_of_gates_alone(sentence, looks):
    assert Evidence(Understanding()).refused(sentence) == looks


@pytest.mark.parametrize(
    "sentence",
    [
        "avoid the dog", "not through the dog", "anything but the dog", "anywhere but the dog please",
        "leave out the dog", "dogs are off limits", "the dog must not be flown through",
        "everything except the dog", "forget the dog",
        "évite le chien", "tout sauf le chien", "alles außer dem Hund", "meide den Hund",
    ],
)  # fmt: skip
def test_a_thing_that_a_sentence_denies_is_not_meant(sentence):
    assert Evidence(Understanding()).refused(sentence) == {"Fly to the dog"}


@pytest.mark.parametrize(
    "sentence",
    ["nothing but the dog", "don't forget the dog", "the man without a hat", "no animal", "the cat, not the dog"],
)
def test_what_sounds_like_a_denial_whole_kinds_and_what_is_named_beside_what_is_meant_forbid_no_thing(sentence):
    assert Evidence(Understanding()).refused(sentence) == frozenset()
