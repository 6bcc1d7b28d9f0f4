"""Which directive is flown by: a hesitant one is soon corrected, one that was confirmed is not given up lightly."""

import math

import pytest

from cognitivedrone.control.directive_filter import DirectiveFilter, FilterRule, meaning_of
from cognitivedrone.tasks.directives import HOLD
from cognitivedrone.types import Guidance

RED, BLUE = "Fly through the big red round gate", "Fly through the small blue square gate"


def heard(directive_filter, *answers):
    return [
        directive_filter.update(Guidance(text, None, confidence), at) for at, (text, confidence) in enumerate(answers)
    ]


def test_the_first_answer_is_adopted_and_repeated_ones_agree():
    directive_filter = DirectiveFilter()
    assert directive_filter.guidance(0.0) is None
    assert heard(directive_filter, (RED, 0.2), (RED, 0.9)) == ["adopted", "agreed"]
    assert directive_filter.guidance(3.5).age == pytest.approx(2.5)
    assert directive_filter.guidance(3.5).confidence == 0.9


def test_a_hesitant_answer_gives_way_to_a_sure_one_at_once():
    directive_filter = DirectiveFilter()
    assert heard(directive_filter, (RED, 0.4), (BLUE, 1.0)) == ["adopted", "adopted"]
    assert directive_filter.guidance(1.0).directive == BLUE


def test_after_seconds_of_agreement_it_takes_three_to_turn():
    directive_filter = DirectiveFilter()
    assert heard(directive_filter, *[(RED, 1.0)] * 6, *[(BLUE, 1.0)] * 3)[6:] == ["kept", "kept", "adopted"]


def test_answers_that_change_every_time_do_not_make_it_waver():
    directive_filter = DirectiveFilter()
    output = heard(directive_filter, *[(RED, 1.0), (BLUE, 1.0)] * 10)
    assert output.count("adopted") == 1


def test_other_words_of_the_same_meaning_agree():
    directive_filter = DirectiveFilter()
    assert heard(directive_filter, (RED, 1.0), ("Go to the large circular red gate", 1.0)) == ["adopted", "agreed"]
    assert meaning_of("Land now") == "land now"
    assert meaning_of(RED) != meaning_of("Fly through the red gate")


def test_a_rule_without_memory_follows_every_answer():
    directive_filter = DirectiveFilter(FilterRule(fading=0.0))
    assert heard(directive_filter, (RED, 1.0), (BLUE, 0.5), (RED, 0.5)) == ["adopted"] * 3


def test_only_several_answers_in_a_row_decline():
    directive_filter = DirectiveFilter()
    assert heard(directive_filter, (HOLD, 1.0), (HOLD, 1.0)) == ["kept", "kept"]
    assert directive_filter.guidance(2.0) is None
    assert heard(directive_filter, (HOLD, 1.0), (HOLD, 1.0)) == ["adopted", "agreed"]


def test_an_answer_in_between_begins_the_count_anew():
    directive_filter = DirectiveFilter()
    assert heard(directive_filter, (HOLD, 1.0), (RED, 0.3), *[(HOLD, 1.0)] * 3)[1:] == [
        "adopted", "kept", "kept", "adopted"
    ]  # fmt: skip


def test_nothing_is_declined_while_the_policy_is_surer_that_it_is_there():
    directive_filter = DirectiveFilter()
    directive_filter.policy_says(0.9)  # odds of 9, which count as 3
    assert heard(directive_filter, *[(HOLD, 0.8)] * 5) == ["kept"] * 5
    assert heard(directive_filter, *[(HOLD, 0.85)] * 3) == ["kept", "kept", "adopted"]
    directive_filter.policy_says(0.99)
    assert heard(directive_filter, (HOLD, 0.85)) == ["agreed"]


@pytest.mark.parametrize(
    ("present", "absent", "declined"),
    [(1.0, 1.0, True), (1.0, 0.9, False), (0.0, 0.0, False), (None, 1.0, True), (math.nan, 1.0, True)],
)
def test_certainties_are_weighed_and_a_policy_without_an_opinion_keeps_nobody_from_declining(present, absent, declined):
    directive_filter = DirectiveFilter()
    directive_filter.policy_says(present)
    assert (heard(directive_filter, *[(HOLD, absent)] * 3)[-1] == "adopted") == declined
