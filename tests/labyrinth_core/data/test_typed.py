"""JSON is read as a type, or refused in one line that names the place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypedDict

import pytest

from labyrinth_core.typed import Count, Like, Share, Within, read_as


class Open(TypedDict):
    """At least these keys."""

    epoch: Count


@dataclass(frozen=True)
class Closed:
    """Exactly these fields."""

    kind: Literal["closed"]
    number: Annotated[float, Within(-1, 1)]
    pair: tuple[Count, Share]
    rows: tuple[tuple[int, ...], ...]
    names: Mapping[Annotated[str, Like("[a-z]+")], Open]
    learnt: Count | Literal["fresh"] | None
    flag: bool
    rest: Any
    more: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.rest == "no":
            raise ValueError("rest=no: it is not allowed")


RIGHT: dict[str, Any] = {
    "kind": "closed",
    "number": 1,
    "pair": [3, 0.5],
    "rows": [[1, 2], []],
    "names": {"a": {"epoch": 1, "loss": 0.5}},
    "learnt": None,
    "flag": True,
    "rest": {"any": [1]},
}


def test_what_fits_becomes_the_type_and_keeps_what_an_open_object_has_besides() -> None:
    found = read_as(Closed, RIGHT)
    assert found == Closed(**RIGHT | {"pair": (3, 0.5), "rows": ((1, 2), ())})
    assert found.names["a"] == {"epoch": 1, "loss": 0.5}
    assert read_as(Closed, RIGHT | {"learnt": "fresh", "more": ["x"]}).more == ["x"]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"kind": "open"}, "it.kind is 'open', not 'closed'"),
        ({"number": True}, "it.number is True, not a number from -1 to 1"),
        ({"number": float("nan")}, "it.number is nan, not a number from -1 to 1"),
        ({"number": 10**400}, "it.number is 1000*, not a number from -1 to 1"),
        ({"pair": [1]}, r"it.pair is \[1\], not a list of 2"),
        ({"pair": [1.5, 0]}, r"it.pair\[0\] is 1.5, not a whole number from 0 to 1e\+15"),
        ({"pair": {}}, r"it.pair is {}, not a list of 2"),
        ({"rows": [[1], [2, "3"]]}, r"it.rows\[1\]\[1\] is '3', not a whole number"),
        ({"rows": [[1], [2, 10**16]]}, r"it.rows\[1\]\[1\] is 10*, not a whole number"),
        ({"names": {"A\n": {}}}, r"it.names has a name that is 'A\\n', not a text like \[a-z\]\+"),
        ({"names": {"a": {}}}, "it.names.a has no epoch"),
        ({"names": {"a": []}}, r"it.names.a is \[\], not an object with epoch"),
        ({"learnt": "x"}, r"it.learnt is 'x', not a whole number from 0 to 1e\+15"),
        ({"learnt": True}, r"it.learnt is True, not a whole number from 0 to 1e\+15"),
        ({"flag": 1}, "it.flag is 1, not true or false"),
        ({"rest": "no"}, "rest=no: it is not allowed"),
        ({"more": "x"}, "it.more is 'x', not a list"),
        ({"e\x1b": 1}, r"it has e\\x1b, which is unknown"),
        (None, "it has no kind"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line_with_its_place(changed: Any, why: str) -> None:
    with pytest.raises(ValueError, match=rf"\A{why}\Z") as refused:
        read_as(Closed, {} if changed is None else RIGHT | changed)
    assert str(refused.value).isprintable()


def test_an_error_in_the_code_that_takes_the_value_is_no_fault_of_the_file() -> None:
    @dataclass
    class Broken:
        number: int

        def __post_init__(self) -> None:
            raise TypeError("a bug")

    with pytest.raises(TypeError):
        read_as(Broken, {"number": 1})
