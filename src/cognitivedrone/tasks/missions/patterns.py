"""The words that cut a mission into its parts: patterns of what people say between two orders, before and after them.

`cutting` applies them. All ignore case.
"""

from __future__ import annotations

import re

from cognitivedrone.types import COLORS

COLOR = "|".join(COLORS)
GO = (
    r"(?:fly|go|head|take|pass|visit|pick|choose|find|look for|get|steer|aim|make for|do|through|thru|to|into|under|"
    r"hit|see|hover over|hover at)"
)
NAMED = re.compile(rf"(?:{GO}|the|a|an|any|some|whatever|whoever|what|who|come|back|if)\b", re.I)
"""How a part of a mission mostly begins."""
LANDING = (
    r"(?:(?:come\s+(?:back\s+)?down|get\s+(?:yourself\s+|it\s+|her\s+)?(?:back\s+)?down(?=\s+on)|(?:come\s+in\s+to\s+)?land(?:ing)?|touch(?:ing)?\s*down|set\s+(?:it\s+|her\s+|yourself\s+)?down|"
    rf"(?:back\s+)?down(?=\s+(?:on|at)\s+(?:the\s+)?(?:pad|red|green|blue)\b)|"
    r"(?:finish|end)(?:ing)?(?:\s+up)?(?=\s+(?:on|at)\b[^,;.]*\bpad\b)|"
    r"landen?|atterris|aterriza|atterra|"
    r"put\s+(?:it|her|yourself)\s+down|park(?:ing)?(?:\s+(?:it|her|yourself))?(?=\s+(?:on|at)\b)|(?:finish|end)\s+with\s+a\s+landing)\b"
    rf"(?=\W*$|\W+(?:on|at|in|there|here|please|pls|it|right|softly|gently|after(?:wards?)?|again|safely|back|{COLOR})\b))"
)
OVER = r"(?:done|through|past|passed|finished|flown|visited|there)"
ONCE = (
    rf"(?:once|when|as soon as)\s+(?:you(?:'?re|'?ve|\s+are|\s+have)?|that(?:'?s| is)|it(?:'?s| is)|this is)\s+{OVER}"
    r"(?:\s+(?:with\s+)?(?:it|that|this|so))?|(?:(?<=[,;.]\s)|(?<=and\s))"
    r"(?:once|when)\s+(?:through|past|done|there|finished)(?=,|\s+(?:land|go|fly|head|take))"
)
NEXT = re.compile(
    r"(?<!er)(?<!ess)(?<!ore)[,;.!\s]*(?:\b(?:and|but)\b|&)?\s*\b(?:(?:then|thn|after (?:that|this|which|it)(?! one)|"
    r"only then|"
    r"(?<!land )(?<!landing )afterwards?|later(?: on)?|"
    r"(?<=[,.;]\s)(?:continue|carry on|move on|proceed|go on)(?= to\b)|"
    rf"(?<=[,.;!]\s)(?:second|third|next|last|final)(?:ly| up| thing| stop| gate)?(?=:|,? (?:{GO})\b)|"
    r"(?<=[,.;]\s)next(?= the| a| go| fly| do|,)|(?<=and )next(?= the| a| go| fly| do|,)|finally|lastly|last of all|"
    r"in the end|at the end|second(?:ly)?(?=,)|third(?:ly)?(?=,)|followed by|"
    r"dann|danach|puis|ensuite|luego|despu[eé]s|poi|daarna|"
    rf"from there|to finish(?: off)?(?=,| {LANDING})|{ONCE})\b(?!\s*\?)[,:\s]*(?:(?:on|onwards?)(?= to\b))?\s*)+|"
    rf"[,;.!]?\s+before\s+(?:you\s+)?(?={LANDING})|"
    rf"[,;.!]\s*(?:(?:and|then)\s+)?(?={LANDING})|\s+(?:and|&&?)\s+(?:then\s+|you can\s+)?(?={LANDING})|"
    r"\s*(?:->|=>|\u2192)\s*",
    re.I,
)
AGAIN = r"(?:then\s+)?(?=(?:fly|go|head)\s+(?:to|through|thru|over to)\s+(?!it\b|that\b|this\b|there\b|them\b))"
AND_ON = re.compile(rf"[,;.]?\s+(?:and|&)\s+{AGAIN}", re.I)
"""Between two orders to fly, in a sentence that begins with one."""
OTHER = r"(?!(?:(?:to|through|thru|for|at|in|on)\s+)?(?:it|its|that|this|there|them|his|her|the\s+gate)\b)"
ON = re.compile(
    rf"(?:[,;.]\s+(?:(?:and|&)\s+)?|\s+(?:and|&)\s+){AGAIN}|"
    rf"[.;!]\s+(?=(?:fly|go|head|take|visit|pass|hit)\s+{OTHER})",
    re.I,
)
FLIES = re.compile(r"(?:please\s+)?(?:fly|go|head)\b", re.I)
"""Not "look for it and go through its gate", which is one order."""
CORRECTED = re.compile(
    r"\b(?:no|not|don't|dont|never|wait|sorry|mean|meant|actually|instead|rather|scratch|cancel|nope|nah|forget|nvm|oops)\b",
    re.I,
)
"""Where an order after a comma may replace the one before."""
NUMBERED = re.compile(
    r"(?:^|[,;.]?\s+)(?:\(?(?P<digit>[1-9])[.)]\s+|step\s+(?P<word>one|two|three|four|five|[1-5])\s*(?:is\b|:)?\s*|"
    r"(?P<plain>one|two|three|four|five):\s+)",
    re.I,
)
FIRST = re.compile(
    r"^\W*(?:(?:hey|hi|hello|ok|okay|so|now|please|pls|drone|alright|right)\b[\s,!:]*)*"
    r"(?:(?:(?:first|frist|fist)(?:ly)?(?: of all| off| up| thing| stop| gate)?(?! letter| from| in| on)|"
    r"to begin with|start with|begin with|(?:start|begin) off (?:with|at|by)|zuerst|d'abord|primero|prima|"
    r"start at|start by|begin at|(?:your|the) (?:route|tour|order)(?: today)? is|\w+ (?:gates|stops)(?: for you)?:)"
    r"(?:\b|(?<=:))[,:\s]*)+",
    re.I,
)
LAND = re.compile(
    rf"^(?:please\s+)?(?:it(?:'?s| is) time to\s+|(?:be|make) sure to\s+|remember to\s+)?"
    rf"(?:you\s+(?:can\s+|may\s+|should\s+|must\s+)?)?(?:{LANDING}|(?:come|go|fly|head)\s+(?:back\s+)?home\b)"
    rf"(?:[^.;]*?\b(?P<color>{COLOR})\b)?",
    re.I,
)
PLACE = re.compile(
    r"\bon(?:to)?\s+(?:(?:the|a|an|my|your|that|this)\s+)?(?:(?P<pad>(?:\w+\s+)*?)(?:heli|landing\s+)?pad\b|"
    r"(?P<other>\w+))",
    re.I,
)
ANY_PAD = frozenset(
    (*COLORS, "blu", "the", "a", "landing", "big", "small", "round", "square", "right", "correct", "nearest", "next",
     "last", "other", "only", "ground", "floor", "spot", "place", "target", "platform", "mat", "one", "it", "top",
     "your", "my", "and")
)  # fmt: skip
"""Words that describe a pad, or any place to land on."""
NEVER = re.compile(
    r"[,;.\s]*\b(?:but\s+|and\s+)?(?:(?:never|not ever|do not|don't|dont)\s+(?:ever\s+)?(?:fly\s+|go\s+)?"
    r"(?:through|thru|take)|avoid|stay away from|keep (?:away|clear) (?:from|of)|not through|"
    rf"no(?=\s+(?:{COLOR})\s+(?:gates?|ones?)\b))\s+(?:the\s+|a\s+|any\s+|anything\s+)?"
    rf"(?P<color>{COLOR})(?:\s+(?:gates?|ones?|frames?))?\b"
    r"(?!\s+(?:hat|hair|shirt|top|beanie|jacket|clothes))(?:,?\s+(?:on the way|ever|though|please))*",
    re.I,
)
ELSE = r"\b(?:otherwise|else|if not|or else)\b"
IF = re.compile(
    r"^(?:and\s+)?if\s+(?:there(?:'s| is| are)|you (?:can )?(?:see|find|spot)|(?:one of them|one|a gate|any gate) "
    r"(?:shows|has))\s+(?P<first>.+?)(?:,|\s+then\b|\s+(?=(?:take|fly|go)\b))\s*(?:then\s+)?(?P<act>.*?)[,;.]?\s*"
    rf"{ELSE}[,\s]*(?P<other>.+)$",
    re.I,
)
IF_ANY = re.compile(
    rf"^(?P<first>.+?)\s+if\s+(?:there(?:'s|\s+is)\s+(?:one|any)|"
    rf"you\s+(?:can\s+)?(?:see|find|spot)\s+(?:one|it|any))[,;.]?\s*"
    rf"(?:or\s+)?{ELSE}[,\s]*(?P<other>.+)$",
    re.I,
)
IT = re.compile(rf"^(?:{GO}\s+)*(?:it|that|that one|this one|there)?\W*$", re.I)
COUNTS = {
    "twice": 2, "thrice": 3, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9,
    "ten": 10, "eleven": 11, "twelve": 12, "dozen": 12, "hundred": 100, "thousand": 1000,
}  # fmt: skip
TIMES = re.compile(
    r"[,\s]*\b(?:(?P<once>twice|thrice)|(?P<cross>[2-9])\s?x(?=\s+(?:the|a|an)\b)|(?:an?\s+)?(?P<count>\d{1,9}|"
    rf"{'|'.join(each for each in COUNTS if each not in ('twice', 'thrice'))})\s+times)\b"
    r"(?!\s+\d|\s+(?:one|two|three|four|five|six|seven|eight|nine|ten)\b)",
    re.I,
)
TIMES_THROUGH = re.compile(
    rf"\W*(?:the|a|an)\s+\w+(?:\s+\w+)?\s+(?:twice|thrice|{'|'.join(COUNTS)}\s+times)\W*$|"
    rf"\W*(?:twice|thrice|(?:\d{{1,9}}|{'|'.join(COUNTS)})\s+times)\s+(?:through|thru|past|over|to)\s+(?:the|a|an)\b",
    re.I,
)
ORDER = re.compile(
    r"^(?P<word>before|after)\s+(?P<one>[^,]+),\s*(?P<two>.+)$|"
    rf"^(?P<flown>(?:after|having)\s+(?:passing|taking|visiting|doing|flown\s+through|passed|visited)|"
    r"(?:as soon as|once|when)\s+you(?:'ve|\s+have|\s+are|'re)\s+(?:done(?:\s+with)?|passed|past|flown\s+through|"
    r"through)|(?:as soon as|once|when|after)\s+you\s+(?:pass|reach|visit|(?:go|fly)\s+through))"
    rf"\s+(?P<past>.+?)(?:,\s*|\s+(?={GO}\b))(?P<on>.+)$|"
    rf"^after\s+(?P<after>(?:the|a|an)\s+\w+)\s+(?P<goes>(?:fly|go|head|take|pass|visit|do|the|a|an)\b.+)$",
    re.I,
)
THING = r"(?!(?:the\s+)?(?:gate|one|letter|number|panel|animal|thing|what|something)\b)"
BETWEEN = re.compile(
    rf"^(?P<one>(?:please\s+)?(?:fly|go|head|take|pass|visit|do|land)\b(?:\s+(?:to|through|thru|on|over|past|by))*\s+"
    rf"{THING}[\w\s']{{2,30}}?)\s+(?P<word>before|prior to|after)\s+(?:you\s+)?"
    r"(?:(?:fly|go|take|visit|do|pass)(?:ing)?\s+(?:(?:to|through|thru)\s+)?)?"
    rf"(?P<two>(?:the|a|an)\s+{THING}[\w\s']{{3,25}})\W*$|"
    r"^(?P<late>(?:the|a|an)\s+[\w\s']{2,20}),?\s+but\s+"
    r"(?P<early>(?:the|a|an)\s+[\w\s']{2,20})\s+before\s+(?:that|it)\W*$|"
    r"^(?:(?:your|the)\s+(?:last|final)\s+(?:stop|gate|one)\s+is\s+)?(?P<last>[^,;.]{2,40}?),?\s+but\s+"
    r"(?:before\s+that|first)\b,?\s+(?P<now>[^,;.]{2,40}?)\W*$",
    re.I,
)
START_AND_END = re.compile(
    r"^(?:start|begin)(?:\s+off)?\s+(?:with|at|by|from)\s+(?P<one>.{2,60}?)[,;.]?\s+(?:and\s+|then\s+)*"
    r"(?:end|finish)(?:\s+up)?\s+(?:with|at|by)\s+(?P<two>.{2,60})$",
    re.I,
)
IN_ORDER = re.compile(r"^(?P<all>.+?),?\s+in\s+(?:that|this|the\s+given)\s+(?:order|sequence)\W*$", re.I)
WANTED = re.compile(rf"^(?:please\s+)?(?:i\s+want|give\s+me|{GO}(?:\s+(?:to|through|thru))?)\s+", re.I)
LISTED = re.compile(r",\s*(?:and\s+)?|\s+and\s+")
COMMA = re.compile(r",\s*(?:and\s+)?")
ARTICLE = re.compile(r"(?:the|a|an)\s", re.I)
ROUTE = re.compile(r"\b(?:route|tour|order)\b")
ORDINAL = re.compile(
    r"^(?P<one>[\w\s']{2,40}?)\s+first\b(?!\s+(?:letter|name|of|place))[,\s]*(?:and\s+|then\s+)?(?P<two>[\w\s']{2,40}?)"
    r"(?:\s+(?:second|next|after(?:\s+(?:that|it))?|afterwards|last))\W*$|"
    r"^(?P<late>[\w\s']{2,40}?)\s+(?:second|last)[,\s]+(?:and\s+)?(?P<early>[\w\s']{2,40}?)\s+first\W*$",
    re.I,
)
HE = re.compile(r"\b(?:it|that animal|this animal|that thing|that one)\b", re.I)
OPENING = re.compile(
    rf"^(?:please\s+)?(?:{GO}\s+)*(?:(?:the\s+)?(?:gate|one|panel)\s+(?:with|showing|that shows|of)\s+)?", re.I
)
WEAK = re.compile(r"go on\W*$", re.I)
NO_MISSION = re.compile(
    r"^(?:and\s+|you\s+)?(?:subtract|multiply|divide|take\s+(?:away|off)|add|plus|minus|less|times|double|"
    r"halve|decide|evaluate|compute|calculate|solve|work out|figure out)\b|"
    r"\b(?:take|knock|put|give|bump|have|had|ate|left)\b.*\b(?:away|off|back|up|left|out)\W*$|"
    r"\b(?:your head|half of that|the result(?! of)|your number|of that)\b|"
    r"^(?:the\s+)?(?:board|result|answer|gate)\W*$",
    re.I,
)
"""Said of calculations, which have steps, too."""
REPEATED = re.compile(r"([,;.!?])[,;.!?\s]*(?=[,;.!?])")
SOMEBODY = frozenset(("you", "it", "he", "she", "they", "we", "i", "one", "people", "who", "that", "which"))
GATE = re.compile(r"that (?:with|of|showing)\b", re.I)
CALL = re.compile(
    r"^\W*(?:(?:could|can|would) you|i(?:'d| would) like you to|i (?:want|need) you to|let's|lets)\s+(?:please\s+)?",
    re.I,
)
