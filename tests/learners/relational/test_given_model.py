"""The given model of Mario against the engine, in a level without things."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import begin
from hrljax.envs.mario.env import Mario
from hrljax.learners.relational.given_model import MarioDynamics


def level(exit_column: int) -> str:
    """Ground with a step, a pipe, a wall and a pit 4 wide at column 28; the exit alone is a thing."""
    rows = [["."] * 60 for _ in range(15)]
    for column in range(60):
        for row in (13, 14):
            rows[row][column] = "." if 28 <= column < 32 else "#"
    rows[12][9] = rows[12][10] = rows[11][10] = "%"
    rows[11][16:18], rows[12][16:18] = "[]", "{}"
    rows[9][20] = rows[9][21] = "u"
    things = [["."] * 60 for _ in range(15)]
    things[12][exit_column] = "!"
    picture = ["".join(row) for row in rows], ["".join(row) for row in things]
    return "\n".join(["type: overground", *picture[0], "", *picture[1]])


ENV = Mario(levels=(level(45), level(26)), preset="thesis")
FAR, NEAR = range(2)
begun = jax.jit(lambda number: begin(ENV.course, number))


@jax.jit
def both(state: Any, ahead: Any, action: jax.Array) -> Any:
    """A step of the engine, what the model says of it, and what it said when it looked ahead from the start."""
    _, after, reward, terminated, _, info = ENV.step(jax.random.key(0), state, action)
    model, start = MarioDynamics().planned(ENV, (), state)
    from_here, promised = model(start, action)
    return after, reward, terminated, info, from_here, promised, model(ahead, action)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "seed", "end"), [(FAR, 0, "death"), (FAR, 1, "death"), (NEAR, 3, "win")])
def test_a_look_ahead_is_what_the_engine_does(number: int, seed: int, end: str):
    """Bit for bit, in position, in every field of Mario and in reward, to the end of the episode and beyond."""
    generator = np.random.default_rng(seed)
    state = begun(number)
    _, ahead = MarioDynamics().planned(ENV, (), state)
    for _ in range(150):
        action = jnp.int32(generator.choice([0, 2, 4, 5, 6, 7, 8, 8, 8]))
        after, reward, terminated, info, from_here, promised, (ahead, foreseen) = both(state, ahead, action)
        ended_unseen = after.phase == 1  # dead in the last tick of a step, told in the next
        if not ended_unseen and not terminated:
            assert float(promised) == float(foreseen) == float(reward)
        for name in ("x", "y", "xa", "ya", "on_ground", "may_jump", "jump_time", "sliding", "facing"):
            assert getattr(from_here.player, name) == getattr(after.world.player, name), name
            assert getattr(ahead.player, name) == getattr(after.world.player, name), name
        state = after
        if terminated:
            assert bool(info[end])
            break
    else:
        pytest.fail("the walk was to end")
    assert float(both(state, ahead, jnp.int32(0))[-1][1]) == 0


@pytest.mark.slow
def test_the_end_pays_what_the_preset_says():
    """Running into the pit costs a death on the way down, once."""
    state = begun(FAR)
    pit = 28.6 * 16
    world = state.world._replace(player=state.world.player._replace(x=jnp.float32(pit), y=jnp.float32(230.0)))
    model, start = MarioDynamics().planned(ENV, (), state._replace(world=world))

    def run(start: Any) -> Any:
        return jax.lax.scan(lambda s, _: model(s, jnp.int32(4)), start, None, 8)

    _, rewards = jax.jit(run)(start)
    assert np.sum(np.asarray(rewards) < -40) == 1
    assert (np.asarray(rewards)[np.argmin(rewards) + 1 :] == 0).all()


@pytest.mark.slow
def test_a_root_with_it_clears_the_level(quick_compiler: None):
    learner = hrl.RelationalHORDQ(
        hrl.SearchRoot(model=MarioDynamics(), priority="last_reward", answer="leaf"), pseudo_reward=1e6, epsilon=0.0
    )
    run = jax.jit(lambda key: hrl.train(ENV, learner, key, 2))(jax.random.key(0))
    assert float(run.metrics["win"].sum()) == 2
