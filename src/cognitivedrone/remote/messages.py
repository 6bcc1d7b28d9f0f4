"""Messages between a policy server and its clients: as bytes, what they contain, and their checks.

As bytes they are msgpack, with NumPy arrays encoded as openpi's clients and servers do. The protocol is openpi's: the
server sends metadata, then answers each observation with actions and timings; errors are text frames. Everything beyond
it is optional: `ask`, `reset`, `session` and `protocol` in observations, and the entry `cognitivedrone` in the
metadata, by which a client knows that it may send them. Tables in docs/own_policy.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final, Literal, TypeAlias, cast, get_args

import numpy as np

from cognitivedrone.errors import (
    ActionError,
    CognitiveDroneError,
    MessageError,
    MessageFault,
    NonFiniteAction,
    PolicyError,
    ReasonerError,
    ReasonerFault,
    ServerError,
    import_extra,
)
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import IMAGE_SIZE, EpisodeContext, Guidance, Image, Observation

EXTRA = "remote"
"""The extra that installs the packages of this one."""
LARGEST_BYTES: Final = 1 << 20
"""Maximum size of a message; one image has 197 kB."""
DTYPES: Final = {np.dtype(name).str for name in ("?", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")}
"""Element types of arrays, as NumPy writes them: little-endian numbers."""
_MOST_AXES = 8
_MOST_ITEMS = 4096
"""Of a list or map; actions of a whole flight as a list are shorter."""


def pack(message: object) -> bytes:
    """A message of maps, lists, text, numbers and arrays; raises `TypeError` for anything else."""
    packed: bytes = import_extra("msgpack", EXTRA).packb(message, default=_encoded)
    return packed


def unpack(data: bytes, largest_bytes: int = LARGEST_BYTES) -> Any:
    """The message; arrays are its own copies. Raises `MessageError` if it is malformed or too large."""
    if len(data) > largest_bytes:
        raise MessageError("too_large", f"the message has {len(data)} bytes; at most {largest_bytes} are accepted")
    try:
        return import_extra("msgpack", EXTRA).unpackb(
            data,
            object_hook=_decoded,
            ext_hook=_refuse,
            max_array_len=_MOST_ITEMS,
            max_map_len=_MOST_ITEMS,
            max_str_len=largest_bytes,
            max_bin_len=largest_bytes,
        )
    except MessageError:
        raise
    except Exception as error:  # of many unrelated classes
        reason = str(error) or type(error).__name__
        raise MessageError("bad_message", f"the message is not msgpack as expected: {reason[:200]}") from None


def array_of(data: object, dtype: object, shape: object) -> np.ndarray[Any, Any]:
    """The array with these parts, checked; raises `MessageError`."""
    if not isinstance(dtype, str) or dtype not in DTYPES:
        raise MessageError("bad_array", f"an array has the dtype {dtype!r:.40}; use one of {', '.join(sorted(DTYPES))}")
    if (
        not isinstance(shape, list)
        or len(shape) > _MOST_AXES
        or not all(type(size) is int and 0 <= size < 2**31 for size in shape)
    ):
        raise MessageError(
            "bad_array", f"an array has the shape {shape!r:.60}; it is a list of up to {_MOST_AXES} sizes"
        )
    expected = math.prod(shape) * np.dtype(dtype).itemsize
    if not isinstance(data, bytes) or len(data) != expected:
        found = f"{len(data)} bytes" if isinstance(data, bytes) else type(data).__name__
        raise MessageError("bad_array", f"an array {dtype} {shape} has {found} of data; expected {expected} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape).copy()


def _encoded(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic) and value.dtype.str not in DTYPES:
        raise TypeError(f"arrays of dtype {value.dtype} cannot be sent; use one of {', '.join(sorted(DTYPES))}")
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"a {type(value).__name__} cannot be sent")


def _decoded(table: dict[Any, Any]) -> Any:
    if b"__ndarray__" in table:
        return array_of(table.get(b"data"), table.get(b"dtype"), table.get(b"shape"))
    if b"__npgeneric__" in table:
        dtype, value = table.get(b"dtype"), table.get(b"data")
        if not isinstance(dtype, str) or dtype not in DTYPES or not isinstance(value, bool | int | float):
            raise MessageError("bad_array", f"a NumPy scalar has the dtype {dtype!r:.40} and the value {value!r:.40}")
        try:
            return np.dtype(dtype).type(value)
        except (OverflowError, ValueError):
            raise MessageError("bad_array", f"the NumPy scalar {value!r:.40} does not fit its dtype {dtype}") from None
    return table


def _refuse(code: int, _data: bytes) -> Any:
    raise MessageError("bad_message", f"the message has an extension type ({code}); none is accepted")


PROTOCOL: Final = 1
"""Version of what this project adds to openpi's protocol."""
OURS: Final = "cognitivedrone"
"""Key of the server's own entry in the metadata."""
TOKEN_VARIABLE: Final = "COGNITIVEDRONE_SERVER_TOKEN"  # noqa: S105 - the variable's name
IMAGE: Final = "observation/image"
STATE: Final = "observation/state"
PROMPT: Final = "prompt"
TIME: Final = "time"
LONGEST_PROMPT: Final = 10_000
"""Maximum length in characters; policies set shorter limits of their own."""
LARGEST_STATE: Final = 1e6
"""Maximum magnitude of a velocity, height or rate."""
LONGEST_ERROR: Final = 1000
"""Maximum length of an error's message, in characters; more of it is not read."""
MOST_RESETS: Final = 256
"""Maximum number of stages in one message."""

Message: TypeAlias = Mapping[str, Any]
Ask = Literal["pilot", "policy", "guidance"]
"""What an observation asks for: actions of the policy behind the server's reasoner (openpi's clients), actions of the
policy alone, or the reasoner's answer."""

_IMAGE_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)
_RAISED: dict[MessageFault, type[PolicyError]] = {
    "policy_error": PolicyError,
    "bad_action": ActionError,
    "non_finite_action": NonFiniteAction,
}


def observation_message(observation: Observation) -> dict[str, Any]:
    """An observation as openpi's servers expect it; the state has the numbers that the policy would get here."""
    state = [*observation.velocity, observation.height, observation.yaw_rate]
    return {
        IMAGE: observation.image,
        STATE: np.array(state, dtype=np.float64),
        PROMPT: observation.instruction,
        TIME: float(observation.time),
    }


def reset_message(context: EpisodeContext) -> dict[str, Any]:
    """The start of a stage, without what only a simulator knows."""
    same = {"same_stage": True} if context.same_stage else {}
    return {PROMPT: context.instruction, "stage": context.stage, "seed": context.seed, **same}


def read_observation(message: Message, time_s: float) -> Observation:
    """The observation in a message; `time_s` is used where it has no time. Raises `MessageError`."""
    state = _field(message, STATE, np.ndarray)
    if state.shape != (5,) or state.dtype.kind not in "fiu":
        raise MessageError(
            "bad_field",
            f"{STATE} is {state.dtype} {state.shape}; expected (5,) numbers: velocity x, y, z in m/s, height in m and"
            " yaw rate in rad/s",
        )
    state = state.astype(np.float64)
    if not (np.abs(state) <= LARGEST_STATE).all():  # nor are NaNs
        raise MessageError("bad_field", f"{STATE} is {state.tolist()}; every number is at most {LARGEST_STATE:g}")
    time_given = message.get(TIME, time_s)
    if isinstance(time_given, bool) or not isinstance(time_given, int | float | np.integer | np.floating):
        raise MessageError("bad_field", f"{TIME} is {time_given!r:.60}; expected seconds since the flight's start")
    if not math.isfinite(time_given):
        raise MessageError("bad_field", f"{TIME} is {time_given}; it must be finite")
    return Observation(
        image=read_image(message),
        instruction=read_prompt(message),
        velocity=state[:3].astype(np.float32),
        height=float(state[3]),
        yaw_rate=float(state[4]),
        time=float(time_given),
    )


def read_image(message: Message) -> Image:
    """The image in a message; raises `MessageError`."""
    image: Image = _field(message, IMAGE, np.ndarray)
    if image.shape != _IMAGE_SHAPE or image.dtype != np.uint8:
        resize = image.ndim == 3 and image.shape[2] == 3 and image.shape != _IMAGE_SHAPE
        raise MessageError(
            "bad_field",
            f"{IMAGE} is {image.dtype} {image.shape}; expected uint8 {_IMAGE_SHAPE}, red first"
            + ("; crop and resize it before it is sent" if resize else ""),
        )
    return image


def read_prompt(message: Message) -> str:
    """The instruction in a message; raises `MessageError`."""
    prompt: str = _field(message, PROMPT, str)
    if len(prompt) > LONGEST_PROMPT:
        raise MessageError("bad_field", f"{PROMPT} has {len(prompt)} characters; at most {LONGEST_PROMPT} are accepted")
    return prompt


def read_ask(message: Message) -> Ask:
    """What a message asks for; raises `MessageError`."""
    ask = message.get("ask", "pilot")
    if not isinstance(ask, str) or ask not in get_args(Ask):
        raise MessageError("bad_field", f"ask is {ask!r:.60}; expected {', '.join(get_args(Ask))}")
    return cast("Ask", ask)


def read_resets(message: Message) -> list[EpisodeContext] | None:
    """The stages that a message starts, in order; none if it does not say, as openpi's clients. Raises `MessageError`.

    `reset` is a list of maps with `prompt`, and maybe `stage`, `seed` and `same_stage`; True starts a flight by the
    message's prompt.
    """
    resets = message.get("reset")
    if resets is None or resets is False:
        return None
    if resets is True:
        return [EpisodeContext(read_prompt(message))]
    if not isinstance(resets, list) or len(resets) > MOST_RESETS or not all(isinstance(one, dict) for one in resets):
        raise MessageError(
            "bad_field", f"reset is {resets!r:.60}; expected True or a list of at most {MOST_RESETS} maps"
        )
    return [_context(one) for one in resets]


def _context(reset: Message) -> EpisodeContext:
    same = reset.get("same_stage") is True
    return EpisodeContext(read_prompt(reset), _count(reset, "seed"), _count(reset, "stage"), same_stage=same)


def check_protocol(message: Message, session: str) -> None:
    """Raise `MessageError` if a message is of another version of the protocol, or of another session."""
    version = message.get("protocol", PROTOCOL)
    if type(version) is not int or version != PROTOCOL:
        raise MessageError(
            "protocol_version",
            f"the client speaks version {version!r:.20} of the protocol, this server {PROTOCOL}; install the same"
            " version of cognitivedrone on both sides",
        )
    named = message.get("session", session)
    if not isinstance(named, str) or named != session:
        raise MessageError("unknown_session", f"there is no session {named!r:.60} on this connection; connect again")


def guidance_message(guidance: Guidance) -> dict[str, Any]:
    """A reasoner's answer."""
    return {
        "directive": guidance.directive,
        "gate": guidance.gate,
        "confidence": float(guidance.confidence),
        "present": None if guidance.present is None else float(guidance.present),
    }


def read_guidance(reply: Message) -> Guidance:
    """A reasoner's answer from a message; raises `ReasonerError`. `check_guidance` examines the values."""
    try:
        return Guidance(reply["directive"], reply["gate"], reply["confidence"], present=reply["present"])
    except KeyError as error:
        raise ReasonerError("schema", f"the server's answer has no {error.args[0]!r}") from None


def error_frame(code: MessageFault, message: str, **more: object) -> str:
    """An error as a text frame, or as the body of an HTTP response.

    `more`, where it is not None: of a reasoner's error, `fault` (its kind) and `certainty`.
    """
    given = {name: value for name, value in more.items() if value is not None}
    return json.dumps({"error": {"code": code, "message": message, **given}})


def raise_error(frame: str, where: str) -> None:
    """Raise the error that a server's text frame reports; `where` names the server.

    A policy's own error is raised as the class that it had there; an error of any other server as `ServerError` with
    the last line of its traceback.
    """
    try:
        error = parse_json(frame, non_finite=True)["error"]
        code, fault = error["code"], error.get("fault")
        message = " ".join(str(error["message"]).split())[:LONGEST_ERROR]
        if not isinstance(code, str) or not isinstance(fault, str | None):
            raise TypeError("code and fault are words")
    except (ValueError, TypeError, KeyError, AttributeError):
        last = (frame.strip().splitlines() or ["an empty text"])[-1]
        raise ServerError(f"the policy server at {where} failed: {last[:300]}") from None
    if code == "no_answer":
        raise ReasonerError(cast(ReasonerFault, fault or "raised"), message, certainty=_share(error.get("certainty")))
    if code in _RAISED:
        raise _RAISED[code](message)
    raise ServerError(f"the policy server at {where} refused the message ({code}): {message[:300]}")


def code_of(error: CognitiveDroneError) -> MessageFault:
    """The code of an error in its frame."""
    if isinstance(error, MessageError):
        return error.code
    if isinstance(error, ReasonerError):
        return "no_answer"
    if isinstance(error, NonFiniteAction):
        return "non_finite_action"
    return "bad_action" if isinstance(error, ActionError) else "policy_error"


def _share(value: object) -> float | None:
    """A number from 0 to 1; none for anything else."""
    return float(value) if isinstance(value, int | float) and 0 <= value <= 1 else None


def _field(message: Message, name: str, kind: type) -> Any:
    if name not in message:
        known = ", ".join(sorted(str(key)[:40] for key in message)[:12]) or "nothing"
        raise MessageError("missing_field", f"the message has no {name!r}; it has {known}")
    value = message[name]
    if not isinstance(value, kind):
        expected = "text" if kind is str else "an array"
        raise MessageError("bad_field", f"{name} is {type(value).__name__!r}; expected {expected}")
    return value


def _count(table: Message, name: str) -> int:
    value = table.get(name, 0)
    if type(value) is not int or not 0 <= value < 2**32:
        raise MessageError("bad_field", f"{name} in reset is {value!r:.60}; expected a whole number from 0")
    return value
