"""Records that are made at once are the named tuples they would be anyway."""

from __future__ import annotations

import copy
import gc
import pickle
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest

from cosim.base import signals
from cosim.base._records import quick, within


class Plain(NamedTuple):
    a: Any
    b: Any
    c: Any = 3


@quick
class Quick(NamedTuple):
    a: Any
    b: Any
    c: Any = 3


@pytest.mark.parametrize(
    ("given", "named"),
    [((1, 2, 4), {}), ((1, 2), {}), ((1,), {"b": 2}), ((), {"c": 1, "b": 2, "a": 0}), ((1, 2), {"c": (5,)})],
)
def test_it_is_made_as_ever(given: tuple[Any, ...], named: dict[str, Any]) -> None:
    one, other = Quick(*given, **named), Plain(*given, **named)
    assert tuple(one) == tuple(other)
    assert type(one) is Quick
    assert one._asdict() == other._asdict()
    assert hash(one) == hash(tuple(other))
    assert repr(one) == repr(other).replace("Plain", "Quick")


@pytest.mark.parametrize(
    ("given", "named"), [((), {}), ((1,), {}), ((1, 2, 3, 4), {}), ((1, 2), {"d": 4}), ((1, 2), {"a": 0})]
)
def test_it_refuses_as_ever(given: tuple[Any, ...], named: dict[str, Any]) -> None:
    with pytest.raises(TypeError) as one:
        Quick(*given, **named)
    with pytest.raises(TypeError) as other:
        Plain(*given, **named)
    assert str(one.value) == str(other.value).replace("Plain", "Quick")


def test_it_can_be_copied_changed_and_derived_from() -> None:
    state = signals.Unallocated(1.0, 2.0, 3.0, 4.0)
    assert pickle.loads(pickle.dumps(state)) == state
    assert copy.deepcopy(state) == state
    assert state._replace(roll=5.0) == (5.0, 2.0, 3.0, 4.0)

    class Derived(Quick):
        def __new__(cls, *fields: Any) -> Derived:
            return super().__new__(cls, *fields[::-1])

    assert Derived(1, 2, 3) == (3, 2, 1)


def test_it_holds_its_fields_and_lets_them_go() -> None:
    field = object()
    before = sys.getrefcount(field)
    records = [Quick(field, field, [field]) for _ in range(10)]
    assert sys.getrefcount(field) == before + 30
    records[0].c.append(records)  # a cycle
    del records
    gc.collect()
    assert sys.getrefcount(field) == before


@quick
class Turned(NamedTuple):
    x: Any
    y: Any
    z: Any


def test_the_memory_of_one_is_that_of_another_with_as_many_fields() -> None:
    class Derived(Quick):
        """Larger: it has a dict."""

    field = object()
    types, before = (Quick, Turned, Derived), sys.getrefcount(field)
    counts = [sys.getrefcount(each) for each in types]
    for _ in range(30):
        made = [each(field, k, [k]) for k in range(20) for each in types]
        made[2].own = field  # type: ignore[attr-defined]
        assert [type(one) for one in made] == [*types] * 20
        assert all(tuple(one) == (field, k, [k]) for k in range(20) for one in made[3 * k : 3 * k + 3])
        assert all(gc.is_tracked(one) for one in made)
        assert hash(made[0][:2]) == hash((field, 0))
        del made
    assert sys.getrefcount(field) == before
    assert [sys.getrefcount(each) for each in types] == counts


@pytest.mark.parametrize("other", [tuple, object, int, Plain(1, 2), type("T", (tuple,), {"_fields": ()})])
def test_nothing_but_a_named_tuple_is_taken(other: Any) -> None:
    with pytest.raises(TypeError, match="quick"):
        quick(other)


class Pair(NamedTuple):
    a: Any
    b: Any


@pytest.mark.parametrize(
    "values",
    [
        (0.25, 1.0),
        [0.25, 1.0],
        np.array([0.25, 1.0]),
        np.array([[0.25, 1.0]] * 2)[1],
        [np.float64(0.25), 1.0],
        Pair(0.25, 1.0),
    ],
)
def test_numbers_within_are_a_tuple_of_floats(values: Any) -> None:
    found = within(values, 2, 0.0, 1.0)
    assert found == (0.25, 1.0)
    assert type(found) is tuple
    assert [type(each) for each in found] == [float, float]


@pytest.mark.parametrize(
    "values",
    [
        (0.25,),
        (0.25, 1.0, 0.0),
        (0.25, 1.0 + 1e-15),
        (-1e-300, 1.0),
        [float("nan"), 0.5],
        np.array([0.5, float("inf")]),
        (0.25, 1),
        (0.25, None),
        np.array([0.25, 1.0], np.float32),
        np.array([0.25, 1.0], ">f8"),
        np.array([0.25, 0.0, 1.0])[::2],
        np.array([[0.25, 1.0]]),
        "ab",
        b"abcdefghabcdefgh",
        {0.25: 1.0, 0.5: 1.0},
        None,
        0.5,
    ],
)
def test_anything_else_is_left_to_who_can_say_what_it_is(values: Any) -> None:
    assert within(values, 2, 0.0, 1.0) is None


def test_within_lets_go_of_what_it_was_given() -> None:
    values = [0.125, 0.5]
    array = np.array(values)
    before = sys.getrefcount(values), sys.getrefcount(array)
    for _ in range(10):
        within(values, 2, 0.0, 1.0), within(array, 2, 0.0, 1.0), within(values, 3, 0.0, 1.0)
    assert (sys.getrefcount(values), sys.getrefcount(array)) == before
    array.resize(3, refcheck=False)  # nobody holds its buffer
    with pytest.raises(TypeError):
        within(values, 2, 0.0)  # type: ignore[call-arg]
    with pytest.raises(TypeError):
        within(values, "2", 0.0, 1.0)  # type: ignore[arg-type]
    assert within(values, 10**6, 0.0, 1.0) is None
