"""What a function of one run does otherwise when `vmap` maps it over runs that take their steps together.

Under `vmap` a loop whose condition differs from run to run selects between old and new tables in every turn, and a
branch runs both of its sides. With the functions here conditions are one number for all runs, and what few runs
need is computed for them alone. Outside of `vmap` they are the plain loops that their names say.
"""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_batching import custom_vmap
from jax.extend.core import jaxpr_as_fun

from hrljax.core.flags import choose
from hrljax.core.numerics import of_every_run

T = TypeVar("T")
_BITS = 32


@custom_vmap
def any_run(flag: Array) -> Array:
    """Whether a flag (bool scalar) holds for any run of a batch; of one run, the flag.

    As the condition of a loop it is one number for all, so that no table goes through a select. The
    loop's body has to leave those runs alone whose own flag is False.
    """
    return flag


@any_run.def_vmap
def _any_of_batch(_: int, __: list[bool], flags: Array) -> tuple[Array, bool]:
    return flags.any(), False


def once_if(condition: Array, update: Callable[[T], T], value: T) -> T:
    """``update(value)`` where `condition` (bool scalar) holds, else `value`; a pytree of arrays.

    A loop of at most one turn changes tables in place; a branch would copy them. Under `vmap` on a
    CPU the runs of a batch that need it are updated one after the other; elsewhere all are, and
    those that do not need it keep what they had.
    """
    leaves, tree = jax.tree.flatten(value)
    traced = jax.make_jaxpr(lambda *leaves: jax.tree.leaves(update(jax.tree.unflatten(tree, leaves))))(*leaves)
    arguments, results = traced.jaxpr.invars, traced.jaxpr.outvars
    changes = [argument is not result for argument, result in zip(arguments, results, strict=True)]

    def updated(constants: list[Array], kept: list[Array], changed: list[Array]) -> list[Array]:
        """The leaves that change, after they have."""
        of_each, others = iter(changed), iter(kept)
        whole = [next(of_each if does else others) for does in changes]
        new = jaxpr_as_fun(traced.replace(consts=constants))(*whole)
        return [leaf for leaf, does in zip(new, changes, strict=True) if does]

    @custom_vmap
    def alone(condition: Array, fixed: tuple[list[Array], list[Array]], changed: list[Array]) -> list[Array]:
        def turn(carry: tuple[Array, list[Array]]) -> tuple[Array, list[Array]]:
            return jnp.bool_(False), updated(*fixed, carry[1])

        return lax.while_loop(lambda carry: carry[0], turn, (condition, changed))[1]

    @alone.def_vmap
    def of_batch(
        size: int, batched: Any, condition: Array, fixed: tuple[list[Array], list[Array]], changed: list[Array]
    ) -> tuple[list[Array], list[bool]]:
        spread = partial(of_every_run, size)
        conditions, changed = spread(condition, batched[0]), list(map(spread, changed, batched[2]))

        def one_by_one() -> list[Array]:
            def of_run(run: Array, changed: list[Array]) -> list[Array]:
                def row(leaf: Array, is_batched: bool = True) -> Array:
                    return lax.dynamic_index_in_dim(leaf, run, 0, keepdims=False) if is_batched else leaf

                constants, kept = jax.tree.map(row, fixed, batched[1])
                new = updated(constants, kept, list(map(row, changed)))
                return [
                    lax.dynamic_update_index_in_dim(rows, after, run, 0)
                    for rows, after in zip(changed, new, strict=True)
                ]

            return _for_each_true(conditions, of_run, changed)

        def all_at_once() -> list[Array]:
            axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched[1])

            def chosen(condition: Array, fixed: tuple[list[Array], list[Array]], changed: list[Array]) -> list[Array]:
                return choose(condition, updated(*fixed, changed), changed)

            return jax.vmap(chosen, (0, axes, 0))(conditions, fixed, changed)

        return lax.platform_dependent(cpu=one_by_one, default=all_at_once), [True] * len(changed)

    kept = [leaf for leaf, does in zip(leaves, changes, strict=True) if not does]
    changed = [leaf for leaf, does in zip(leaves, changes, strict=True) if does]
    after = iter(alone(condition, (list(traced.consts), kept), changed))
    return jax.tree.unflatten(tree, [next(after) if does else leaf for leaf, does in zip(leaves, changes, strict=True)])


def _for_each_true(flags: Array, function: Callable[[Array, T], T], value: T) -> T:
    """``function(i, value)`` for every i (int32) with ``flags[i]`` (``[N]`` bool), in order."""
    rows = jnp.pad(flags, (0, -len(flags) % _BITS)).reshape(-1, _BITS).astype(jnp.uint32)
    masks = (rows << np.arange(_BITS, dtype=np.uint32)[None]).sum(1, dtype=jnp.uint32)

    def of_mask(number: Array, value: T) -> T:
        def lowest_bit(carry: tuple[Array, T]) -> tuple[Array, T]:
            mask, value = carry
            lowest = mask & -mask
            place = np.int32(_BITS - 1) - lax.clz(lowest).astype(jnp.int32)
            return mask ^ lowest, function(number * np.int32(_BITS) + place, value)

        return lax.while_loop(lambda carry: carry[0] != 0, lowest_bit, (masks[number], value))[1]

    return lax.fori_loop(0, len(masks), of_mask, value)


def one_after_another(function: Callable[..., T]) -> Callable[..., T]:
    """A function of pytrees of arrays that `vmap` computes on a CPU for one run after the other, not for all at once.

    Suits what is full of loops and branches that differ from run to run.
    """

    @wraps(function)
    def of_pytrees(*arguments: Any) -> T:
        traced, result = jax.make_jaxpr(function, return_shape=True)(*arguments)

        def run(held: list[Array], leaves: list[Array]) -> list[Array]:
            return jaxpr_as_fun(traced.replace(consts=held))(*leaves)

        # A branch that differs from run to run makes of the arrays that the function holds one for each, which
        # `custom_vmap` allows of arguments alone.
        alone = custom_vmap(run)

        @alone.def_vmap
        def of_batch(size: int, batched: Any, held: list[Array], leaves: list[Array]) -> tuple[list[Array], list[bool]]:
            whole, is_batched = [*held, *leaves], [*batched[0], *batched[1]]
            varying = [leaf for leaf, varies in zip(whole, is_batched, strict=True) if varies]

            def of_run(varying: list[Array]) -> list[Array]:
                rest = iter(varying)
                mixed = [next(rest) if varies else leaf for leaf, varies in zip(whole, is_batched, strict=True)]
                return run(mixed[: len(held)], mixed[len(held) :])

            results = lax.platform_dependent(
                cpu=lambda: lax.map(of_run, varying), default=lambda: jax.vmap(of_run, axis_size=size)(varying)
            )
            return results, [True] * len(results)

        return jax.tree.unflatten(jax.tree.structure(result), alone(list(traced.consts), jax.tree.leaves(arguments)))

    return of_pytrees
