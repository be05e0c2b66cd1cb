"""Proximal policy optimisation as purejaxrl writes it: all of a run in one compiled function of a key.

It knows of an environment what gymnax says: `reset`, `step`, `observation_space`, `action_space`.
Networks are plain arrays, so that nothing but optax is needed.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array


class Config(NamedTuple):
    num_envs: int = 32
    num_steps: int = 64
    num_updates: int = 40
    epochs: int = 4
    minibatches: int = 4
    learning_rate: float = 5e-3
    hidden: int = 32
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.01
    reward_scale: float = 0.05


class Transition(NamedTuple):
    obs: Array
    action: Array
    log_probability: Array
    value: Array
    reward: Array
    done: Array


def network(key: Array, sizes: tuple[int, ...]) -> list[tuple[Array, Array]]:
    keys = jax.random.split(key, len(sizes) - 1)
    initializer = jax.nn.initializers.orthogonal()
    return [
        (initializer(k, shape, jnp.float32), jnp.zeros(shape[1], jnp.float32))
        for k, shape in zip(keys, zip(sizes, sizes[1:], strict=False), strict=True)
    ]


def apply(layers: list[tuple[Array, Array]], x: Array) -> Array:
    """Of one observation."""
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias


def make_train(config: Config, env: Any, env_params: Any) -> Callable[[Array], Array]:
    """Returns key -> ``[updates]`` float32: mean return of the episodes that ended during each update."""
    size = env.observation_space(env_params).shape[0]
    num_actions = env.action_space(env_params).n
    optimiser = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(config.learning_rate, eps=1e-5))
    batch_size = config.num_envs * config.num_steps

    def policy(weights: Any, obs: Array) -> Array:
        return jax.nn.log_softmax(jax.vmap(apply, (None, 0))(weights["actor"], obs))

    def value_of(weights: Any, obs: Array) -> Array:
        return jax.vmap(apply, (None, 0))(weights["critic"], obs)[:, 0]

    def env_step(carry: tuple[Any, ...], key: Array) -> tuple[Any, Any]:
        weights, env_state, obs, returns = carry
        key_action, key_step = jax.random.split(key)
        log_probabilities = policy(weights, obs)
        action = jax.random.categorical(key_action, log_probabilities)
        keys = jax.random.split(key_step, config.num_envs)
        next_obs, env_state, reward, *ended, _ = jax.vmap(env.step, (0, 0, 0, None))(
            keys, env_state, action, env_params
        )
        done = reduce(jnp.logical_or, ended)
        log_probability = jnp.take_along_axis(log_probabilities, action[:, None], 1)[:, 0]
        returns = returns + reward
        finished = jnp.where(done, returns, jnp.nan)
        seen = Transition(
            obs, action, log_probability, value_of(weights, obs), reward * config.reward_scale, done.astype(jnp.float32)
        )
        return (weights, env_state, next_obs, jnp.where(done, 0.0, returns)), (seen, finished)

    def advantages(seen: Transition, last_value: Array) -> Array:
        def backward(carry: tuple[Array, Array], step: Transition) -> tuple[Any, Array]:
            advantage, next_value = carry
            goes_on = 1 - step.done
            delta = step.reward + config.discount * next_value * goes_on - step.value
            advantage = delta + config.discount * config.gae_lambda * goes_on * advantage
            return (advantage, step.value), advantage

        start = (jnp.zeros_like(last_value), last_value)
        return jax.lax.scan(backward, start, seen, reverse=True)[1]

    def loss(weights: Any, batch: tuple[Transition, Array, Array]) -> Array:
        seen, advantage, target = batch
        log_probabilities = policy(weights, seen.obs)
        log_probability = jnp.take_along_axis(log_probabilities, seen.action[:, None], 1)[:, 0]
        ratio = jnp.exp(log_probability - seen.log_probability)
        scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        clipped = jnp.clip(ratio, 1 - config.clip, 1 + config.clip)
        actor = -jnp.minimum(ratio * scaled, clipped * scaled).mean()
        critic = jnp.square(value_of(weights, seen.obs) - target).mean()
        entropy = -(jnp.exp(log_probabilities) * log_probabilities).sum(-1).mean()
        return actor + 0.5 * critic - config.entropy_weight * entropy

    def learn(carry: tuple[Any, Any], batch: Any) -> tuple[Any, None]:
        weights, memory = carry
        change, memory = optimiser.update(jax.grad(loss)(weights, batch), memory)
        return (optax.apply_updates(weights, change), memory), None

    def update(carry: tuple[Any, ...], key: Array) -> tuple[Any, Array]:
        weights, memory, env_state, obs, returns = carry
        key_steps, key_epochs = jax.random.split(key)
        (_, env_state, obs, returns), (seen, finished) = jax.lax.scan(
            env_step, (weights, env_state, obs, returns), jax.random.split(key_steps, config.num_steps)
        )
        advantage = advantages(seen, value_of(weights, obs))
        batch = jax.tree.map(lambda x: x.reshape(batch_size, *x.shape[2:]), (seen, advantage, advantage + seen.value))

        def epoch(carry: tuple[Any, Any], key: Array) -> tuple[Any, None]:
            order = jax.random.permutation(key, batch_size)
            parts = jax.tree.map(lambda x: x[order].reshape(config.minibatches, -1, *x.shape[1:]), batch)
            return jax.lax.scan(learn, carry, parts)

        (weights, memory), _ = jax.lax.scan(epoch, (weights, memory), jax.random.split(key_epochs, config.epochs))
        return (weights, memory, env_state, obs, returns), jnp.nanmean(finished)

    def train(key: Array) -> Array:
        key_actor, key_critic, key_reset, key_updates = jax.random.split(key, 4)
        weights = {
            "actor": network(key_actor, (size, config.hidden, num_actions)),
            "critic": network(key_critic, (size, config.hidden, 1)),
        }
        obs, env_state = jax.vmap(env.reset, (0, None))(jax.random.split(key_reset, config.num_envs), env_params)
        start = (weights, optimiser.init(weights), env_state, obs, jnp.zeros(config.num_envs, jnp.float32))
        return jax.lax.scan(update, start, jax.random.split(key_updates, config.num_updates))[1]

    return train
