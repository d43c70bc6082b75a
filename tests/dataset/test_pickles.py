"""Pickles from strangers: plain values are read, everything else is refused unrun."""

import os
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenediff_classic.dataset.pickles import read_pickle
from scenediff_classic.errors import InputError

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
plain = st.recursive(
    scalars | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner),
    max_leaves=10,
)


def reread(path, value, protocol):
    path.write_bytes(pickle.dumps(value, protocol=protocol))
    return read_pickle(path)


@settings(max_examples=40)
@given(plain, st.sampled_from(PROTOCOLS))
def test_plain_values_survive(tmp_path_factory, value, protocol):
    assert reread(tmp_path_factory.getbasetemp() / "value.pkl", value, protocol) == value


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_containers_and_numpy_values(tmp_path, protocol):
    value = {
        "set": {1, 2},
        "frozen": frozenset("ab"),
        "tuple": (1, "x", bytearray(b"yz")),
        "row": np.arange(6, dtype=np.int32).reshape(2, 3),
        "column": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "big": np.arange(3, dtype=">u2"),
        "bool": np.array([True, False]),
        "zero": np.array(2.5),
        "scalar": np.float32(0.5),
        "flag": np.bool_(True),
        "empty": np.zeros((0, 2)),
    }
    assert reread(tmp_path / "value.pkl", value, protocol) == {
        "set": {1, 2},
        "frozen": frozenset("ab"),
        "tuple": (1, "x", bytearray(b"yz")),
        "row": [[0, 1, 2], [3, 4, 5]],
        "column": [[0, 1, 2], [3, 4, 5]],
        "big": [0, 1, 2],
        "bool": [True, False],
        "zero": [2.5],
        "scalar": 0.5,
        "flag": True,
        "empty": [],
    }


def test_pickles_of_numpy_1_are_read(tmp_path):
    """NumPy 1 named its core module ``numpy.core``, and old files still do."""
    path = tmp_path / "old.pkl"
    new = pickle.dumps(np.int64(7), protocol=2)
    path.write_bytes(new.replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    assert read_pickle(path) == 7


class Call:
    def __init__(self, function, *arguments):
        self.reduced = function, arguments

    def __reduce__(self):
        return self.reduced


@pytest.mark.parametrize(
    "attack",
    [
        Call(os.system, "touch {mark}"),
        Call(eval, "open('{mark}', 'w')"),
        Call(getattr, "text", "upper"),
        Call(__import__, "os"),
        Call(open, "{mark}", "w"),
        Call(np.fromfile, "{mark}"),
        Call(np.ndarray, (2,), "O"),
        Call(print, "hello"),
    ],
    ids=lambda a: a.reduced[0].__name__,
)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_code_is_refused_and_not_run(tmp_path, attack, protocol):
    mark = tmp_path / "mark"
    function, arguments = attack.reduced
    filled = (a.format(mark=mark) if isinstance(a, str) else a for a in arguments)
    path = tmp_path / "object_masks.pkl"
    path.write_bytes(pickle.dumps({"H": 1, "x": Call(function, *filled)}, protocol=protocol))
    with pytest.raises(InputError) as error:
        read_pickle(path)
    assert str(path) in str(error.value)
    assert not mark.exists()


def test_refusal_names_what_was_asked_for(tmp_path):
    path = tmp_path / "object_masks.pkl"
    path.write_bytes(pickle.dumps(Call(os.system, "true")))
    with pytest.raises(InputError, match=r"asks for (posix|nt)\.system, but only plain values"):
        read_pickle(path)


def test_arrays_of_objects_are_refused(tmp_path):
    with pytest.raises(InputError, match="the NumPy type 'O8'"):
        reread(tmp_path / "value.pkl", np.array([{}, None], dtype=object), 4)


def test_stand_ins_cannot_be_changed(tmp_path):
    """BUILD on a named global, with a state that would set an attribute of it."""
    path = tmp_path / "value.pkl"
    path.write_bytes(b"cnumpy\ndtype\n(N}U\x08__call__Nstb.")
    with pytest.raises(InputError, match="damaged"):
        read_pickle(path)


def test_more_data_in_the_shape_than_in_the_file(tmp_path):
    data = pickle.dumps(np.zeros(4, np.uint8), protocol=2)
    path = tmp_path / "value.pkl"
    path.write_bytes(data.replace(b"K\x04\x85", b"J\xff\xff\xff\x7f\x85"))
    with pytest.raises(InputError, match="damaged"):
        read_pickle(path)


@pytest.mark.parametrize("data", [b"", b"not a pickle", pickle.dumps([1, 2, 3])[:-3], b"\x80\xff."])
def test_damaged_files(tmp_path, data):
    path = tmp_path / "value.pkl"
    path.write_bytes(data)
    with pytest.raises(InputError, match="not a readable pickle"):
        read_pickle(path)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_pickle(tmp_path / "value.pkl")
