"""Code that needs the value of a traced array fails with one sentence that says what to write instead."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.core.tracing_errors import explain_tracing

TABLE = np.arange(5)


def branches(x: Any) -> Any:
    if x > 2:
        return 1
    return 0


@pytest.mark.parametrize(
    ("function", "advice"),
    [
        (branches, r"use jnp\.where in place of if, and &, \| and ~ in place of and, or and not \(.*if x > 2:\)$"),
        (lambda x: (x > 2) and (x < 4), r"use jnp\.where in place of if, and &, \| and ~"),
        (lambda x: max(x, 2), r"use jnp\.where in place of if, and &, \| and ~"),
        (lambda x: TABLE[x], r"use jax\.numpy, such as jnp\.asarray\(table\)\[index\]"),
        (lambda x: [3, 4, 5, 6][x], r"use jax\.numpy, such as"),
        (lambda x: {3: 1}[x], r"use jax\.numpy, such as"),
        (np.sin, r"use jax\.numpy, such as"),
        (int, r"use jax\.numpy, such as"),
        (lambda x: jnp.arange(3)[jnp.arange(3) > x], r"use jax\.numpy, such as"),
    ],
)
@pytest.mark.parametrize("transform", [jax.jit, lambda function: lambda x: jax.vmap(function)(x[None])])
def test_one_sentence_says_what_to_write_instead(function: Any, advice: str, transform: Callable[..., Any]):
    with (
        pytest.raises(TypeError, match="^Corridor: transition .*" + advice) as raised,
        explain_tracing("Corridor: transition"),
    ):
        transform(lambda x: function(x))(jnp.int32(3))
    assert "Tracer" not in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_array_that_was_left_behind_is_told_of():
    stored = []
    jax.jit(lambda x: stored.append(x + 1))(jnp.int32(3))
    with pytest.raises(TypeError, match="keep NumPy arrays from call to call"), explain_tracing("encode"):
        jax.jit(lambda x: x + stored[0])(jnp.int32(3))


def test_other_errors_stay_as_they_are():
    with pytest.raises(TypeError, match=r"^mine$"), explain_tracing("encode"):
        raise TypeError("mine")
    with pytest.raises(KeyError), explain_tracing("encode"):
        {}["x"]
