"""Decay is IEEE's, bit by bit, for every significand, subnormal numbers included."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.envs.mario.engine.arithmetic import decayed, factor, is_negative, is_positive, select_factor, tile_of

SIGNIFICANDS = np.arange(1 << 23, dtype=np.uint32)
SUBNORMAL, LEAST_NORMAL, ONE = 0, 1, 127
"""Biased exponents."""
compiled = jax.jit(jax.vmap(decayed, (0, None)))


@pytest.mark.parametrize("constant", [0.82, 0.95, 0.9, np.float32(0.85), np.float32(0.95)])
@pytest.mark.parametrize("exponent", [SUBNORMAL, LEAST_NORMAL, ONE])
def test_decay_of_every_significand(constant: float, exponent: int):
    values = (SIGNIFICANDS[:: 1 if exponent == ONE else 5] | np.uint32(exponent << 23)).view(np.float32)
    expected = (values.astype(np.float64) * float(constant)).astype(np.float32)
    np.testing.assert_array_equal(compiled(values, factor(constant)).view(np.uint32), expected.view(np.uint32))


def test_sign_and_zero():
    values = np.array([-0.0, 0.0, -7.3, -1e-44], np.float32)
    expected = (values.astype(np.float64) * 0.82).astype(np.float32)
    np.testing.assert_array_equal(compiled(values, factor(0.82)).view(np.uint32), expected.view(np.uint32))


def test_standing_still_never_brings_the_velocity_to_zero():
    velocity = jnp.float32(3)
    for _ in range(600):
        velocity = jax.jit(decayed)(velocity, factor(0.82))
    assert velocity.view(jnp.uint32) == 2  # 2.8e-45, where the original gets stuck too
    assert is_positive(velocity)
    assert not is_negative(velocity)
    assert is_negative(-velocity)
    assert not is_positive(jnp.float32(0))
    assert not is_negative(jnp.float32(-0.0))


def test_chosen_factor():
    chosen = select_factor(jnp.bool_(True), factor(0.9), factor(0.82))
    assert decayed(jnp.float32(1), chosen) == np.float32(0.9)


def test_factor_out_of_range():
    with pytest.raises(ValueError, match=r"\[0.5, 1\), got 1.5"):
        factor(1.5)


def test_tiles_are_counted_towards_zero():
    np.testing.assert_array_equal(jax.vmap(tile_of)(jnp.array([-17.0, -5.0, 0.0, 15.9, 16.0])), [-1, 0, 0, 0, 1])
