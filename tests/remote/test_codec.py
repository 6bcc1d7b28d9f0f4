"""Messages as bytes: what openpi sends is read, what could do harm is not."""

import contextlib
import pickle

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as some_numpy
from policy_clients import decode, encode

from cognitivedrone.errors import MessageError
from cognitivedrone.remote.messages import DTYPES, pack, unpack

ARRAYS = some_numpy.arrays(
    some.sampled_from(sorted(DTYPES)), some_numpy.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5)
)
VALUES = some.recursive(
    some.none() | some.booleans() | some.integers(-(2**63), 2**64 - 1) | some.floats() | some.text() | some.binary(),
    lambda inner: some.lists(inner, max_size=4) | some.dictionaries(some.text(), inner, max_size=4),
    max_leaves=12,
)


def array(**changed):
    """An encoded array that is as it should be, but for what is changed."""
    table = {"__ndarray__": True, "data": bytes(12), "dtype": "<f4", "shape": [3]} | changed
    return msgpack.packb({name.encode(): value for name, value in table.items() if value is not None})


@given(ARRAYS)
def test_arrays_come_back_to_the_bit(sent):
    received = unpack(pack({"x": sent}))["x"]
    assert (received.dtype, received.shape, received.tobytes()) == (sent.dtype, sent.shape, sent.tobytes())
    assert received.flags.writeable


@given(VALUES)
def test_plain_values_come_back(sent):
    assert repr(unpack(pack(sent))) == repr(sent)


@given(ARRAYS)
def test_arrays_are_written_and_read_as_openpi_does(sent):
    theirs = msgpack.packb({"x": sent}, default=encode)
    assert pack({"x": sent}) == theirs
    assert unpack(theirs)["x"].tobytes() == msgpack.unpackb(theirs, object_hook=decode)["x"].tobytes()


def test_numpy_scalars_come_back():
    received = unpack(pack({"x": np.float32(0.1), "y": np.int64(-3), "z": np.bool_(True)}))
    assert received == {"x": np.float32(0.1), "y": -3, "z": True}
    assert isinstance(received["x"], np.float32)


@pytest.mark.parametrize("value", [np.array([object()]), np.array(["text"]), np.array([1j]), {1, 2}, object()])
def test_nothing_else_is_sent(value):
    with pytest.raises(TypeError, match="cannot be sent"):
        pack({"x": value})


class Harmful:
    """Would set `ran` if it were unpickled."""

    ran = False

    def __reduce__(self):
        return setattr, (Harmful, "ran", True)


@pytest.mark.parametrize(
    "changed",
    [
        {"dtype": "|O", "data": pickle.dumps(Harmful())}, {"dtype": "O"}, {"dtype": "<U3"}, {"dtype": ">f4"},
        {"dtype": "<f4,<f4"}, {"dtype": [["a", "<f4"]]}, {"dtype": None}, {"dtype": 4}, {"shape": [4]},
        {"shape": [2]}, {"shape": [-3]}, {"shape": [True, 3]}, {"shape": [3.0]},
        {"shape": [2**31, 2**31, 2**31, 2**31]}, {"shape": [2**62, 4]}, {"shape": [1] * 40}, {"shape": 3},
        {"shape": None}, {"data": "text text t"}, {"data": [0] * 12}, {"data": None}, {"data": b""},
    ],
)  # fmt: skip
def test_an_array_that_is_not_one_is_refused(changed):
    with pytest.raises(MessageError, match=r"^an array") as caught:
        unpack(array(**changed))
    assert caught.value.code == "bad_array"
    assert not Harmful.ran


@pytest.mark.parametrize(("dtype", "value"), [("|O", 1), ("|u1", 300), ("<f4", "1"), ("<f4", None), (None, 1)])
def test_a_scalar_that_is_not_one_is_refused(dtype, value):
    with pytest.raises(MessageError, match="NumPy scalar"):
        unpack(msgpack.packb({b"__npgeneric__": True, b"data": value, b"dtype": dtype}))


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\xc1", b"\x82\xa1a", b"\xdb\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\x91" * 100_000,
        b"\xa1\xff", msgpack.packb(msgpack.ExtType(5, b"x")), msgpack.packb({1: 2}), msgpack.packb([0] * 5000),
        pack({}) + b"\x00",
    ],
)  # fmt: skip
def test_what_is_no_message_is_refused(data):
    with pytest.raises(MessageError, match="the message") as caught:
        unpack(data)
    assert caught.value.code == "bad_message"


@given(some.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data):
    with contextlib.suppress(MessageError):
        unpack(data)


def test_a_large_message_is_refused_before_it_is_read():
    with pytest.raises(MessageError, match="at most 100 are accepted") as caught:
        unpack(bytes(101), 100)
    assert caught.value.code == "too_large"
