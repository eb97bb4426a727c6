"""Records that are made at once are the named tuples they would be anyway."""

from __future__ import annotations

import copy
import gc
import pickle
import sys
from typing import Any, NamedTuple

import pytest

from cosim.base import signals
from cosim.base._records import quick


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


@pytest.mark.parametrize("other", [tuple, object, int, Plain(1, 2), type("T", (tuple,), {"_fields": ()})])
def test_nothing_but_a_named_tuple_is_taken(other: Any) -> None:
    with pytest.raises(TypeError, match="quick"):
        quick(other)
