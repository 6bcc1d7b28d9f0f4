"""What sentences are understood to ask for: slang, typing errors, corrections, other languages; and what not."""

import pytest

from cognitivedrone.apps.understanding.request import Understanding
from cognitivedrone.apps.understanding.sentence import distance
from cognitivedrone.models.words.refusals import normalised, things_denied, wanted_and_refused

UNDERSTANDING = Understanding(
    {"robin": frozenset({"birds/robin", "birds/robin_2"}), "blue tit": frozenset({"birds/blue-tit"})}
)


def asked(sentence: str) -> set[str]:
    request = UNDERSTANDING.understand(sentence)
    assert request.understood, request
    return set(request.labels)


@pytest.mark.parametrize(
    ("sentence", "label"),
    [
        ("hey drone, could you please go thru the one with the doggo", "animal/dog"),
        ("Would you kindly avoid the red gate and choose the fruit that monkeys love?", "food/banana"),
        ("My daughter's birthday is tomorrow, she adores penguins, so please fly to the penguin", "animal/penguin"),
        ("flytothebanana", "food/banana"),
        ("the dog, no wait, the cat", "animal/cat"),
        ("neither the cat nor the dog but the horse", "animal/horse"),
        ("I've got a dog at home but today show me the cat", "animal/cat"),
        ("a bird that cannot fly", "animal/penguin"),
        ("the thing that keeps you dry in the rain", "object/umbrella"),
        ("which one would a rabbit eat?", "food/carrot"),
        ("you pig, fly to the clock already", "object/alarm_clock"),
        ("fliege durch das Tor mit dem Hund", "animal/dog"),
        ("vuela a través de la puerta con el plátano", "food/banana"),
        ("\N{SLICE OF PIZZA}", "food/pizza"),
        ("what is 3 + 4?", "number/7"),
        ("the letter after B", "letter/C"),
        ("Fly inside of gate with letter of name M", "letter/M"),
        ("the Apple logo", "logo/apple"),
        ("m", "letter/M"),
        ("catt", "animal/cat"),
        ("dog 3", "animal/dog"),
        ("horse? nah, cow", "animal/cow"),
        ("take the truck, cancel that, the bus", "object/bus"),
        ("the cat. the dog instead", "animal/dog"),
        ("not apple - pear!", "food/pear"),
        ("sick of cars, let's take the bike", "object/bicycle"),
        ("sqrt of 25", "number/5"),
        ("fly in the one with the number that comes after six", "number/7"),
        ("take the gate with the number that is 3 less than ten", "number/7"),
        ("I had five apples and ate two - how many are left?", "number/3"),
        ("how many legs does a spider have?", "number/8"),
        ("the bow and arrow", "object/bow_and_arrow"),
    ],
)
def test_one_thing_is_meant(sentence, label):
    assert asked(sentence) == {label}


def test_any_of_several_may_be_meant():
    assert "food/bread" in asked("fly to something you can eat")  # and no frog, which eats flies
    assert not any(label.startswith("animal/") for label in asked("fly to something you can eat"))
    assert asked("the yellow fruit") == {"food/banana", "food/lemon"}
    assert asked("a vegetable that isn't green").isdisjoint(asked("the green vegetable"))
    assert asked("fly to the robin") == {"birds/robin", "birds/robin_2"}
    assert asked("an odd number less than 6, please") == {"number/1", "number/3", "number/5"}
    assert asked("the gate with a number bigger than 10") == {f"number/{number}" for number in range(11, 21)}
    assert {"animal/owl", "animal/penguin"} <= asked("Fly through the gate with the bird")


def test_gates_and_people_are_described():
    request = UNDERSTANDING.understand("the red gate, actually the big blue one")
    assert (request.look, request.labels) == (("big", "blue", None), frozenset())
    assert UNDERSTANDING.understand("teh second gaet pls").place == 1
    assert UNDERSTANDING.understand("whichever gate is green").look == (None, "green", None)
    assert UNDERSTANDING.understand("gehe zum roten Tor").look == (None, "red", None)
    assert (
        UNDERSTANDING.understand("someone with a red hat and a beard").plain
        == "the person with a full beard and a red hat"
    )
    assert UNDERSTANDING.understand("no hats please, the bald guy").plain == "the person with a bald head without a hat"
    for sentence, plain in (
        ("the woman in the green shirt with glasses", "the person with glasses and a green T-shirt"),
        ("a man with a moustache and a blue cap", "the person with a blue hat and a moustache"),
        ("the lady wearing a headscarf", "the person with a headscarf"),
        ("blond girl with sunglasses", "the person with blond hair and sunglasses"),
        ("the bearded man in red", "the person with a full beard and a red T-shirt"),
        ("somebody who laughs", "the person with a laughing face"),
        ("the happy lady", "the person with a laughing face"),
        ("the pirate", "the person with an eyepatch"),
        ("dude wearing a T-shirt", "the person with a blue T-shirt"),
    ):
        assert UNDERSTANDING.understand(sentence).plain == plain
    assert UNDERSTANDING.understand("Fly to Boris").name == "Boris"
    refused = UNDERSTANDING.understand("anything but the banana")
    assert (refused.labels, refused.refused) == (frozenset(), {"food/banana"})


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("take me to the Eiffel Tower", ("eiffel", "tower")),
        ("glorp", ("glorp",)),
        ("fly to the dinosaur with the hat", ("dinosaur",)),
        ("whatever my boss likes", ("boss",)),
        ("how are you?", ()),
        ("fly", ()),
        ("kill all humans", ("kill",)),
        ("third letter of the alphabet", ("third", "alphabet")),
    ],
)
def test_what_is_not_understood_is_reported(sentence, words):
    request = UNDERSTANDING.understand(sentence)
    assert not request.understood
    assert request.unknown == words


def test_a_place_alone_is_a_gate():
    for sentence, place in (
        ("middle", 1),
        ("go right, erm, left", 0),
        ("to the right please", 2),
        ("das linke Tor", 0),
    ):
        assert UNDERSTANDING.understand(sentence).place == place
    assert UNDERSTANDING.understand("all right").place is None
    assert UNDERSTANDING.understand("not the left one").place == 1
    for sentence in ("the third gate", "fly to the 3rd gate", "gate 3", "gate number 3", "the last one"):
        assert (UNDERSTANDING.understand(sentence).place, UNDERSTANDING.understand(sentence).labels) == (2, frozenset())
    assert UNDERSTANDING.understand("durch das blaue Tor").look == (None, "blue", None)


def test_a_denial_holds_for_what_follows_it():
    red = asked("a red fruit that is not an apple")
    assert red == {"food/cherries", "food/strawberry"}
    assert UNDERSTANDING.understand("neither red nor blue").refused_looks == {"red", "blue"}


@pytest.mark.parametrize(
    ("sentence", "note"),
    [
        ("number 42", "gates show whole numbers from 0 to 20, not 42"),
        ("the number -5", "gates show whole numbers from 0 to 20, not -5"),
        ("the letter \N{LATIN CAPITAL LETTER A WITH DIAERESIS}", "gates show the letters A to Z, not"),
        ("what is 5 divided by 2", "has no answer that is a whole number"),
        ("\N{VULGAR FRACTION ONE HALF}", "has no answer that is a whole number"),
        ("fly to the yellow gate", "no gate is yellow: gates are big or small; red, green or blue"),
        ("the fourth gate", "no gate is fourth"),
        ("how many wheels does a banana have?", "it is not known how many wheel that is"),
        ("the apple and the pear", "in no order: say 'first the apple, then the pear'"),
        ("cat, dog, horse", "say 'first the cat, then the dog, then the horse'"),
        ("<script>alert(1)</script>", ""),
        ("find my car keys in the kitchen", ""),
        ("I hate you", ""),
    ],
)
def test_what_is_shown_at_no_gate_is_refused_and_nothing_else_flown_in_its_place(sentence, note):
    request = UNDERSTANDING.understand(sentence)
    assert not request.understood, request
    assert note in request.note


def test_what_has_no_picture_is_reported():
    assert "gates show 0 to 20" in UNDERSTANDING.understand("seven times eight").note
    assert UNDERSTANDING.understand("what the koala likes").note == "no picture is known of what koala likes"


def test_what_is_nearest_to_a_word_is_known():
    nearest = Understanding({"blue tit": frozenset({"birds/blue-tit"})}).nearest
    assert nearest(["castel"]) == ("castle",)
    assert nearest(["kat"]) == ("cat",)  # "Katze"
    assert nearest(["tits"]) == () or nearest(["bluetit"]) == ("blue tit",)
    assert nearest(["dragon"])[:2] == ("lion", "lizard")


@pytest.mark.parametrize("word", ["glorp", "nothing", "drei", "koira", "hold", "friend"])
def test_nothing_is_near_to_a_word_that_means_no_thing(word):
    assert Understanding().nearest([word]) == ()


def test_refusals_are_told_from_wishes():
    assert wanted_and_refused("avoid the red gate and choose the fruit") == ("choose the fruit", " the red gate ")
    for sentence, parts in {
        "fly to the dog, not the cat": ("go to the dog", ("the cat",)),
        "anything but the banana": ("", ("the banana",)),
        "neither the cat nor the bus": ("", ("the cat", "the bus")),
        "I don't want the cat. take the horse": ("i do, take the horse", ("want the cat",)),
        "no pizza, and not the koala, the horse": ("and, the horse", ("pizza", "the koala")),
        "the bird that cannot fly": ("the bird that cannot fly", ()),
        "the animal with no legs": ("the animal with no legs", ()),
        "go past the tree to the car": ("go past the tree to the car", ()),
        "there is no place like home": ("there is no place like home", ()),
    }.items():
        assert things_denied(sentence) == parts
    assert normalised("Don't goooo!! Caf\N{LATIN SMALL LETTER E WITH ACUTE}") == "do not goo!! cafe"
    assert [distance(a, b, 2) for a, b in (("gaet", "gate"), ("elefant", "elephant"), ("cat", "horse"))] == [1, 2, 3]
