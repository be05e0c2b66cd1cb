"""Value iteration on a model that a learner has made."""

import jax.numpy as jnp
import numpy as np

from hrljax.learners.planning import settled


def test_sweeps_end_where_one_changes_little_or_at_the_most():
    """Each sweep halves the values: changes are 4, 2, 1, 0.5 and so on."""

    def after(tolerance: float, most: int) -> float:
        return float(settled(lambda values: values / 2, jnp.full(3, np.float32(8)), jnp.float32(tolerance), most)[0])

    assert after(1.0, 100) == 1.0
    assert after(0.9, 100) == 0.5
    assert after(0.0, 2) == 2.0
    assert after(1.0, 0) == 8.0
