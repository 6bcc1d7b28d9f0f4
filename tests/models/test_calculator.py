"""The calculator does what sentences ask, for every sum of the training tasks, and nothing else."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.models.words.calculator import calculate, evaluate, numeral
from cognitivedrone.models.words.running_total import told
from cognitivedrone.tasks.suites import drawn_task, train_task

ONES = [
    *("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"),
    *("thirteen", "fourteen", "fifteen", "sixteen", "seventeen", "eighteen", "nineteen"),
]
TENS = ["twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety"]


def in_number_words(value):
    """A number in words, written for this test alone."""
    if value < 20:
        return ONES[value]
    if value < 100:
        return TENS[value // 10 - 2] + (f"-{ONES[value % 10]}" if value % 10 else "")
    if value < 1000:
        return f"{ONES[value // 100]} hundred" + (f" and {in_number_words(value % 100)}" if value % 100 else "")
    rest = value % 1000
    joint = " and " if rest < 100 else " "
    return f"{ONES[value // 1000]} thousand" + (f"{joint}{in_number_words(rest)}" if rest else "")


@pytest.mark.parametrize("family", ["math", "two_step"])
def test_all_sums_of_the_generators(family):
    rng = np.random.default_rng(0)
    for number in range(300):
        task = drawn_task(family, rng, f"t/{number}")
        board = None
        if task.board is not None:
            board = evaluate(re.search(r"sum/(.*)@", task.board)[1])
        assert calculate(task.instruction, board) == int(task.options[task.target]), task.instruction


def test_no_number_elsewhere_is_taken_for_a_sum():
    for index in range(2000):
        task = train_task(index, 5)
        if task.family not in ("math",):
            assert calculate(task.instruction) is None, task.instruction


@pytest.mark.parametrize(
    "expression", ["__import__('os')", "2**9", "9/3", "1.5+1", "(" * 40 + "1" + ")" * 40, "9999999*9999999", "", "1+"]
)
def test_nothing_but_arithmetic_is_evaluated(expression):
    assert evaluate(expression) is None


@pytest.mark.parametrize(
    ("sentence", "value"),
    [
        ("Fly through the gate with the number equal to 3*3", 9),
        ("Fly to the gate with the result of 14+(5+0)", 19),
        ("Take the gate under the value of (7 + 2) * 2", 18),
        ("Go through the gate with seven times two", 14),
        ("the answer to 12 − 5", 7),
        ("the answer to 3 × 4", 12),
        ("Add 3 and 4, then take away 2, and fly through the gate with the number you get", 5),
        ("Subtract 4 from 12, then multiply the result by 2, and fly on", 16),
        ("Fly through the gate with the number seventeen", None),
        ("Find the animal with 4-legs", None),
        ("", None),
        # In words
        ("a third of twelve", 4),
        ("half of 8 pls", 4),
        ("two thirds of nine", 6),
        ("1/3 of 12", 4),
        ("¾ of 8", 6),
        ("half of nine", None),
        ("9/2", None),
        ("double 6", 12),
        ("thrice 4", 12),
        ("a dozen", 12),
        ("half a dozen plus one", 7),
        ("half a dozen apples", None),
        ("two dozen minus 4", 20),
        ("a couple more than five", 7),
        ("seven times the sum of two and three", 35),
        ("one more than ten", 11),
        ("5 less than 12", 7),
        ("the difference between 4 and 9", 5),
        ("the product of 2, 3 and 4", 24),
        ("three squared", 9),
        ("2^3", 8),
        ("two³", 8),
        ("the square root of 16", 4),
        ("the square root of 15", None),
        ("what do you get if you take 4 from 9", 5),
        ("9 take away 4", 5),
        ("start with 5, add 3, double it, then subtract 1", 15),
        ("3 + 4, times 2", 14),
        ("(2+three)*2", 10),
        ("9 divided by 3", 3),
        ("4 divided by 0", None),
        ("10% of 50", 5),
        ("fifty percent of eight", 4),
        ("twenty-one minus one", 20),
        ("two hundred and five minus two hundred", 5),
        ("IV + V", 9),
        ("roman numeral XIV", 14),
        ("I add 2 and 8, then multiply the result by 1", 10),
        ("-3+5", 2),
        # Two readings with different values, two sums of different value
        ("twice three plus four", None),
        ("the sum of 2 and 3 times 4", None),
        ("3+4 or 5+6", None),
        # Corrections
        ("3+4, no wait, 5+6", 11),
        ("not 3+4, take 2+2", 4),
        ("no, 3 isn't 8+10, go to the right one", 18),
        # Words of arithmetic that ask for none
        ("the letter that is second of the three in the alphabet", None),
        ("the only number below 12", None),
        ("anything above 5", None),
        ("the one less than ten", None),
        ("the gate between 3 and 4", None),
        ("more butterflies than lemons", None),
        ("one of those three", None),
        ("take the square gate", None),
        ("my number is 7 - go there", None),
        ("12.5 - 3", None),
        ("2" * 200 + "+1", None),
        ("(" * 300 + "1+1" + ")" * 300, None),
    ],
)
def test_what_a_sentence_asks(sentence, value):
    assert calculate(sentence) == value


@pytest.mark.parametrize(
    ("sentence", "value"),
    [
        ("twice the sum on the board", 18),
        ("solve the board, then add 3", 12),
        ("Fly through the gate with the number that is 3 more than the sum on the board", 12),
        ("Fly through the gate with the number that is 3 less than the sum on the board", 6),
        ("take 2 from the sum on the board", 7),
        ("the board minus 2", 7),
        ("take the sum on the board and take away 2", 7),
        ("a third of what's on the board", 3),
        ("the answer to the sum on the board", None),
        ("the correct answer", None),
    ],
)
def test_sums_with_the_board(sentence, value):
    assert calculate(sentence, 9) == value
    assert calculate(sentence) is None


@pytest.mark.parametrize(
    ("words", "value"),
    [("twenty-first", 21), ("12th", 12), ("a hundred", 100), ("hundredth", 100), ("zero", 0), ("three two", None),
     ("", None), ("cat", None), ("nine thousand nine hundred and ninety-nine", 9999)],
)  # fmt: skip
def test_numerals(words, value):
    assert numeral(words) == value


ORDINAL = {"one": "first", "two": "second", "three": "third", "five": "fifth", "eight": "eighth", "nine": "ninth",
           "twelve": "twelfth"}  # fmt: skip


def test_every_number_to_9999_is_read_as_it_is_written():
    for value in (*range(1200), *range(1200, 10000, 37), 9999):
        output = in_number_words(value)
        assert numeral(output) == value, output
        head, _, last = output.replace("-", " ").rpartition(" ")
        ordinal = ORDINAL.get(last) or (last[:-1] + "ieth" if last.endswith("y") else last + "th")
        assert value == 0 or numeral(f"{head} {ordinal}") == value


EXPRESSIONS = st.recursive(
    st.integers(0, 99).map(str),
    lambda inner: st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda each: f"({each[0]}{each[1]}{each[2]})"),
    max_leaves=4,
)


@given(EXPRESSIONS, st.booleans())
def test_what_is_written_in_signs_or_in_words_is_worked_out_alike(expression, words):
    value = eval(expression)  # noqa: S307 - digits, signs and brackets only
    if expression.isdigit() or len(expression) > 40:
        return
    signs = {"+": " plus ", "-": " minus ", "*": " times "}
    spoken = re.sub(r"\d+|[-+*]", lambda part: signs.get(part[0]) or f" {in_number_words(int(part[0]))} ", expression)
    expected = value if abs(value) <= 10**6 else None
    assert calculate(f"go to {spoken if words else expression} please") == expected
    assert evaluate(expression) == expected


@given(st.text(max_size=100))
def test_no_text_breaks_the_calculator(text):
    assert isinstance(calculate(text), int | None)


@pytest.mark.parametrize(
    ("sentence", "result"),
    [
        ("8 and 5 together", 13), ("three and four make", 7), ("add up 3, 4 and 5", 12), ("twenty less five", 15),
        ("4 plus 5 less 3", 6), ("add 4 and 5, less 3", 6), ("one fewer then ten", 9), ("three more then four", 7),
        ("five short of twenty", 15), ("a dozen and a half", 18), ("one and a half dozen", 18),
        ("ten shared between two", 5), ("twelve shared by four people", 3), ("15 split equally into three", 5),
        ("divide twelve between four", 3), ("knock three off ten", 7), ("three off ten", 7), ("take 3 off 10", 7),
        ("twice as many as five", 10), ("half as many as eight", 4), ("three times as many as four", 12),
        ("the number after seven", 8), ("the number right before 9", 8), ("what comes after twelve", 13),
        ("two apples and three pears", None), ("3 and no more", None), ("go off to the gate with 3", None),
        ("the gate after the one with 3", None), ("less 3", None), ("7 then 9", None), ("both 3 and 4", None),
        ("the letter after 3", None), ("3 makes it quick", None),
    ],
)  # fmt: skip
def test_everyday_words_for_arithmetic(sentence, result):
    assert calculate(sentence) == result


@pytest.mark.parametrize(
    ("sentence", "value"),
    [
        ("there were twenty on the bus; nine got off, two hopped on, so now we are", 13),
        ("double five and then put two more on top", 12),
        ("20 apples, I ate 6 and gave away 5, how many have I got?", 9),
        ("I bought two packs of six and later eight more singles", 20),
        ("three fives plus two", 17),
        ("ten minus two, and what's half of that", 4),
        ("how much is six and six", 12),
        ("seven doubled", 14),
        ("sixteen plus.. no, sixteen minus nine", 7),
        ("twenty-one less twenty", 1),
        ("I have ten apples and no pears, ate two. Sorry, which gate?", 8),
        ("50001 lose 50000", 1),
        ("the dog and two cats", None),
        ("more than one but fewer than four", None),
        ("seven sweets, and I ate the whole seven", 0),
        ("three minus five", None),
        ("seven divided by two", None),
        ("five divided by zero", None),
        ("the number 7", None),
        ("", None),
        ("two plus " * 1000, None),
    ],
)
def test_what_is_told_step_by_step_is_calculated(sentence, value):
    assert told(sentence) == value


def test_what_is_told_of_the_board_needs_its_value():
    assert told("do the board thing, then knock three off", 20) == 17
    assert told("do the board thing, then knock three off") is None


@given(st.text(alphabet="two plus off half of the board 3 ,.;-", max_size=300), st.none() | st.integers(0, 400))
def test_any_sentence_tells_a_number_or_nothing(sentence, board):
    assert told(sentence, board) is None or 0 <= told(sentence, board) < 10_000
