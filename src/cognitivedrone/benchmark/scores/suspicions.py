"""What the records of a run say against its policy's input: answers that do not depend on image or instruction."""

from __future__ import annotations

from collections.abc import Iterator

from cognitivedrone.benchmark.scores.results import Results

FEWEST = 10
"""Flights at a gate from which a preference can be inferred."""
ALWAYS = 0.95
"""Share of the flights at one gate that cannot be what the instructions asked for."""
ASKED = 0.6
"""Largest share of the tasks in which one gate may be right, to tell."""
_WAY_OUT = "cognitivedrone doctor --policy ... examines what reaches it"


def suspicions(results: Results) -> Iterator[str]:
    """Sentences about a policy that seems not to see or not to read."""
    episodes = [episode for episode in results.episodes if episode.steps > 0]
    repeated = [episode.repeated for episode in episodes if episode.repeated is not None]
    if episodes and len(repeated) == len(episodes):
        if len(set(repeated)) == 1:
            shown = ", ".join(f"{value:.4g}" for value in repeated[0])
            yield f"the policy gave the same answer ({shown}) for all images and sentences, in every flight; {_WAY_OUT}"
        else:
            yield f"the policy gave the same answer throughout each flight, whatever it saw on the way; {_WAY_OUT}"
    table = results.summary().choices
    flown = [sum(row[gate] for row in table) for gate in range(3)]
    right = [sum(row) for row in table]
    gate = max(range(3), key=lambda each: flown[each])
    if sum(flown) >= FEWEST and flown[gate] >= ALWAYS * sum(flown) and max(right) <= ASKED * sum(right):
        yield (
            f"{flown[gate]} of {sum(flown)} flights went to gate {gate + 1}, which {right[gate]} of {sum(right)} tasks"
            f" asked for: the pilot seems not to follow the instruction; {_WAY_OUT}"
        )
