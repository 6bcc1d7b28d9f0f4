"""What can be wrong with a policy's input, each with the change of the input that undoes it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from cognitivedrone.doctor.subject import ImageChange, StateChange

STATE = ("vx", "vy", "vz", "height", "yaw_rate")
IMAGES: Mapping[str, ImageChange] = {
    "its red and blue channels are exchanged (it expects BGR; images are RGB)": lambda x: x[..., ::-1],
    "its colour channels are rotated (images are RGB)": lambda x: x[..., [1, 2, 0]],
    "its colour channels are rotated the other way (images are RGB)": lambda x: x[..., [2, 0, 1]],
    "its red and green channels are exchanged (images are RGB)": lambda x: x[..., [1, 0, 2]],
    "its green and blue channels are exchanged (images are RGB)": lambda x: x[..., [0, 2, 1]],
    "it is mirrored left to right": lambda x: x[:, ::-1],
    "it is upside down (row 0 is the top)": lambda x: x[::-1],
    "it is turned by 180 degrees": lambda x: x[::-1, ::-1],
    "its rows and columns are exchanged (images are height x width x 3)": lambda x: x.transpose(1, 0, 2),
    "it is turned by 90 degrees to the left": lambda x: np.rot90(x, 1),
    "it is turned by 90 degrees to the right": lambda x: np.rot90(x, -1),
    "its channels come first (images are height x width x 3)": lambda x: x.reshape(3, *x.shape[:2]).transpose(1, 2, 0),
    "its brightness is inverted": lambda x: 255 - x,
}
"""What undoes each fault of the image."""


def _states() -> Iterator[tuple[str, StateChange]]:
    for i, j in itertools.combinations(range(5), 2):
        order = [*range(5)]
        order[i], order[j] = j, i
        yield f"{STATE[i]} and {STATE[j]} are exchanged", partial(np.take, indices=order)
    rolled = (np.roll(range(5), n).tolist() for n in range(1, 5))
    others = ([1, 2, 0, 3, 4], [2, 0, 1, 3, 4], [1, 2, 3, 0, 4], [3, 0, 1, 2, 4], [2, 3, 4, 0, 1], [4, 3, 2, 1, 0])
    for order in (*others, *rolled):
        shown = ", ".join(STATE[i] for i in np.argsort(order))
        yield f"it is read in the order {shown}", partial(np.take, indices=order)
    for i in range(5):
        signs = np.where(np.arange(5) == i, -1.0, 1.0)
        yield f"the sign of {STATE[i]} is inverted", partial(np.multiply, signs)


STATES: Mapping[str, StateChange] = dict(_states())
"""What undoes each fault of the state: numbers exchanged, in another order, or negated."""
RANGES: Mapping[str, ImageChange] = {
    "every image looks black to it": np.zeros_like,
    "all pixels below 255 look black to it": lambda x: np.where(x == 255, 255, 0).astype(np.uint8),
    "all pixels above 0 look white to it": lambda x: np.where(x > 0, 255, 0).astype(np.uint8),
}
"""What does not change the answers of a policy with that fault."""
