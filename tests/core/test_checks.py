"""Checks take what is meant, and say what is allowed and what was given of everything else."""

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.core import checks

Colour = Literal["red", "green"]
NUMBERS_OF_EVERY_KIND = (5, np.int32(5), np.uint8(5), np.array(5), jnp.int32(5))


@pytest.mark.parametrize("value", NUMBERS_OF_EVERY_KIND, ids=repr)
def test_an_integer_of_any_kind_becomes_plain(value: Any):
    assert type(checks.integer("count", value, 1, 5)) is int
    assert checks.integer("count", value, 1, 5) == 5


@pytest.mark.parametrize(
    "value", [*NUMBERS_OF_EVERY_KIND, 0.5, np.float64(0.5), np.float16(0.5), jnp.float32(0.5)], ids=repr
)
def test_a_number_of_any_kind_passes_without_an_array_around_it(value: Any):
    number = checks.number("size", value)
    assert isinstance(number, int | float | np.generic)
    assert number == value


def test_an_interval_holds_what_still_lies_inside_as_float32():
    assert 1.0 in checks.SHARE
    assert 1 + 1e-12 not in checks.SHARE
    positive = checks.Interval(0, 1, low_open=True)
    assert 1e-30 in positive
    assert 1e-60 not in positive
    assert 1 - 1e-9 not in checks.Interval(0, 1, high_open=True)
    assert checks.LARGEST_NUMBER in checks.ANY_NUMBER
    assert 1e39 not in checks.ANY_NUMBER
    assert float("nan") not in checks.Interval(-np.inf, np.inf)
    assert str(positive) == "(0, 1]"
    assert str(checks.ANY_NUMBER) == "[-3.4e+38, 3.4e+38]"


def a_traced(value: Any, check: Callable[[Any], Any]) -> Callable[[], Any]:
    return lambda: jax.eval_shape(check, value)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: checks.integer("n", 0, 1), ValueError, "n must be an integer from 1 to 2147483647, got 0"),
        (lambda: checks.integer("n", 2**31), ValueError, "n must be an integer from 0 to 2147483647, got 2147483648"),
        (lambda: checks.integer("n", 3, 0, 2, meaning="a, b, c"), ValueError, r"n must .* 0 to 2 \(a, b, c\), got 3"),
        (lambda: checks.integer("n", True), TypeError, "n must be an integer from 0 to 2147483647, got True"),
        (lambda: checks.integer("n", np.bool_(True)), TypeError, "n must be an integer from 0 to .*, got np.True_"),
        (lambda: checks.integer("n", 1.0), TypeError, r"n must be an integer from 0 to 2147483647, got 1\.0"),
        (lambda: checks.integer("n", "1"), TypeError, "n must be an integer from 0 to 2147483647, got '1'"),
        (lambda: checks.integer("n", None), TypeError, "n must be an integer from 0 to 2147483647, got None"),
        (lambda: checks.integer("n", np.array([1])), TypeError, r"n must be an integer .*, got array\(\[1\]\)"),
        (
            a_traced(1, lambda n: checks.integer("n", n)),
            TypeError,
            r"n must .*, got a traced int32\[\]; .*static_argnames",
        ),
        (lambda: checks.odd("n", 4, 11), ValueError, "n must be an odd integer from 1 to 11, got 4"),
        (lambda: checks.number("x", 2, checks.SHARE), ValueError, r"x must be a finite number in \[0, 1\], got 2"),
        (lambda: checks.number("x", np.float32(1.4), checks.SHARE), ValueError, r"x must be .*, got 1\.4"),
        (lambda: checks.number("x", "0.1"), TypeError, "x must be a number, got '0.1'"),
        (lambda: checks.number("x", 1j, also=" or a colour"), TypeError, "x must be a number or a colour, got 1j"),
        (lambda: checks.number("x", 10**400), ValueError, r"x must be a finite number in .*, got 1000*\.\.\.$"),
        (a_traced(0.5, lambda x: checks.number("x", x)), TypeError, r"x must be a number, got a traced float32\[\]"),
        (
            a_traced(np.zeros(3, np.float32), lambda x: checks.number("x", x, may_be_traced=True)),
            TypeError,
            r"x must be a number, got a traced float32\[3\]",
        ),
        (lambda: checks.choice("c", "blue", Colour), ValueError, "c must be one of 'red', 'green', got 'blue'"),
        (lambda: checks.choice("c", ["red"], Colour), ValueError, r"c must be one of 'red', 'green', got \['red'\]"),
        (
            lambda: checks.choice("c", np.array(["red"] * 2), Colour),
            ValueError,
            "c must be one of 'red', 'green', got arr",
        ),
        (lambda: checks.flag("f", "no"), ValueError, "f must be one of False, True, got 'no'"),
        (lambda: checks.text("t", 5, "'a'"), TypeError, "t must be a string such as 'a', got 5"),
        (lambda: checks.names("n", "red"), TypeError, "n must be a sequence of names, got 'red'"),
        (lambda: checks.names("n", ["red", 5]), TypeError, r"n must be a sequence of names, got \['red', 5\]"),
        (lambda: checks.path("p", 5), TypeError, "p must be a path: a string or a pathlib.Path, got 5"),
        (lambda: checks.function("f", None, "of a state"), TypeError, "f must be a function of a state, got None"),
        (
            lambda: checks.function("f", lambda: 1, "of a state"),
            TypeError,
            r"f must .*, got one with the arguments \(\)",
        ),
        (
            lambda: checks.probabilities("p", [0.5, 0.6], 2),
            ValueError,
            "p must have no negative entry and .*sum of 1.1",
        ),
        (lambda: checks.probabilities("p", [1.5, -0.5], 2), ValueError, "p must have no negative entry and sum to one"),
        (
            lambda: checks.probabilities("p", [np.nan, 1], 2),
            ValueError,
            "p must have no negative entry and .*sum of nan",
        ),
        (
            lambda: checks.probabilities("p", [1], 2),
            ValueError,
            r"p must be probabilities of shape \(2,\), got shape \(1,\)",
        ),
        (
            lambda: checks.as_array("a", [[1], [1, 2]], np.integer, (2,), "ints"),
            TypeError,
            r"a must be ints of shape \(2,\)",
        ),
        (lambda: checks.as_array("a", [0.5], np.integer, (1,), "ints"), TypeError, r"a must be .* \(1,\), got float64"),
    ],
)
def test_what_is_not_meant_is_named(call: Callable[[], Any], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        call()


def test_a_description_is_one_line_without_traced_values():
    assert checks.described(np.float32(1.4)) == "1.4"
    assert checks.described("a" * 300).endswith("...")
    assert "\n" not in checks.described(np.zeros((3, 3)))
    said = []
    jax.eval_shape(lambda x: said.append(checks.described({"a": [x, 1], "b": (x[0],)})), np.zeros(3, np.float32))
    assert said == ["{'a': [a traced float32[3], 1], 'b': (a traced float32[],)}"]


def test_what_cannot_be_inspected_passes_as_a_function():
    assert checks.function("f", min, "of a state") is min
    assert checks.choice("c", "green", Colour) == "green"
    np.testing.assert_array_equal(checks.probabilities("p", (1, 0), 2), [1.0, 0.0])
