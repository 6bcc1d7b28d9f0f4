"""Wordings of tasks. The last wording of every list is held out: `train` never uses it, `unseen` always does."""

from __future__ import annotations

FRAMES: tuple[str, ...] = (
    "Fly through the gate with {x}",
    "Fly to the gate with {x}",
    "Go through the gate with {x}",
    "Please fly through the gate that shows {x}",
    "Find {x} and fly through that gate",
    "Take the gate under {x}",
    "I want you to fly through the gate with {x}",
    "Look for {x} and go through the gate below",
)
"""Complete sentences around a noun phrase."""
HELD_OUT_FRAMES: tuple[str, ...] = (
    "Head for the gate marked by {x}",
    "The gate you need is the one showing {x}",
    "Aim at {x} and pass beneath",
    "Could you cross the gate labelled with {x}?",
)

ATTRIBUTES = ("the person with {x}", "a person with {x}", "somebody with {x}", "the one who has {x}")
PEOPLE = ("{x}", "the person called {x}", "the portrait of {x}", "our colleague {x}")
LETTERS = ("the letter {x}", "a letter {x}", "letter {x}", "the character {x}")
DIGITS = ("the number {x}", "number {x}", "the number {word}", "the numeral {x}")
LOGOS = ("the {x} logo", "the logo of {x}", "{x}", "the brand mark of {x}")
ANIMALS = ("the {x}", "{a} {x}", "a picture of {a} {x}", "the animal named {x}")
MATH = (
    "the number equal to {x}",
    "the result of {x}",
    "the answer to {x}",
    "the value of {x}",
    "whatever {x} comes to",
)
MATH_BOARD = (
    "the correct answer",
    "the answer to the sum on the board",
    "the result of the sum you see",
    "the solution of what is written on the board",
)
HEALTHY = ("healthy food", "the healthy food", "something healthy", "food that is good for you")
UNHEALTHY = ("unhealthy food", "the unhealthy food", "something unhealthy", "food that is bad for you")
LARGEST = ("the largest number", "the greatest number", "the number that is larger than both others")
SMALLEST = ("the smallest number", "the lowest number", "the number that is smaller than both others")
EVEN = ("the even number", "an even number", "a number that two divides")
ODD = ("the odd number", "an odd number", "a number that two does not divide")
VOWEL = ("the vowel", "a vowel", "a letter that is a vowel")
CONSONANT = ("the consonant", "a consonant", "a letter that is a consonant")

NUMBER_WORDS: tuple[str, ...] = (
    "zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
    "thirteen", "fourteen", "fifteen", "sixteen", "seventeen", "eighteen", "nineteen", "twenty",
)  # fmt: skip
