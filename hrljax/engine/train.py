"""One run: an environment, a learner and a key give what was learned and its curve."""

from collections.abc import Callable, Sequence
from functools import partial

from jax import Array
from jax.core import Tracer

from hrljax.core import checks, forks, random
from hrljax.core.environment import Numbers
from hrljax.core.lockstep import one_after_another
from hrljax.engine.lockstep import Lockstep
from hrljax.engine.run import Run, default_bin_size
from hrljax.engine.start import Start, Startable, checked_start
from hrljax.engine.trainer import Trainer
from hrljax.envs.base import AnyEnvironment, Environment, TabularEnvironment, numbers_of
from hrljax.envs.checks import check_before_training, check_declarations
from hrljax.learners.base import AnyLearner, Learner
from hrljax.learners.hyperparameters import with_tabulated_schedules
from hrljax.learners.measured import Measure, Measured, checked_measures


def train(
    env: AnyEnvironment,
    learner: AnyLearner,
    key: Array,
    num_episodes: int,
    *,
    params: Numbers | None = None,
    bin_size: int | None = None,
    evaluate_every: int | None = None,
    start: Startable | Start | None = None,
    num_steps: int | None = None,
    measures: Sequence[Measure] = (),
) -> Run:
    """Trains a learner for a number of episodes. Pure, for one seed; jit and vmap it.

    Compiled by itself it is correct, but not fast on a CPU: `hrljax.sweep` and `hrljax.engine.batch`
    compile it as a native loop. Under `vmap` on a CPU one run is computed after the other.

    Args:
        env: an environment; a tabular one if the learner is.
        learner: what learns; its numbers may be traced.
        key: a single new-style key; consumed.
        num_episodes: at least 1.
        params: numbers of the environment, `env.default_params` if None; may be traced.
        bin_size: episodes in a bin of the metrics; about a 200th of the run if None.
        evaluate_every: evaluates the greedy policy exactly after every so many bins; never if None.
        start: what training goes on from, a `Run` or a `hrljax.Learned`; from scratch if None. With the
            same key, a run of 500 episodes and 500 more give the same bits as one of 1000; a schedule is
            read on from the episode where the first run ended.
        num_steps: the run ends early, after the bin in which it has taken so many primitive steps, those before `start`
            included; later bins are NaN. Never early if None.
        measures: further metrics, ``"discounted_return"`` (with the learner's discount) and ``"average_reward"`` (per
            step); see `hrljax.learners.measured.Measured`. They change nothing else.

    Raises:
        TypeError, ValueError: a bad argument, or an environment that is not as `hrljax.check` wants it;
            before anything is compiled.
    """

    # Runs that `vmap` puts side by side are slower on a CPU, and XLA up to that of jax 0.10 fails to link what reads
    # large tables for them, unless it is compiled with the options that the engine gives.
    return one_after_another(
        _run_of(env, learner, key, num_episodes, params, bin_size, evaluate_every, start, num_steps, measures)
    )()


def run_once(
    env: AnyEnvironment,
    learner: AnyLearner,
    key: Array,
    num_episodes: int,
    params: Numbers | None = None,
    bin_size: int | None = None,
    evaluate_every: int | None = None,
    start: Startable | Start | None = None,
    num_steps: int | None = None,
    measures: Sequence[Measure] = (),
    vmapped: bool = False,
) -> Run:
    """`train`, with its loop built for the mapping.

    Args:
        env, learner, key, num_episodes, params, bin_size, evaluate_every, start, num_steps, measures: as of
            `train`.
        vmapped: how the loop is built, not what it computes. True suits `vmap`, where all runs of
            a batch take their steps together; False suits one run.
    """
    return _run_of(
        env, learner, key, num_episodes, params, bin_size, evaluate_every, start, num_steps, measures, vmapped
    )()


def _run_of(
    env: AnyEnvironment,
    learner: AnyLearner,
    key: Array,
    num_episodes: int,
    params: Numbers | None,
    bin_size: int | None,
    evaluate_every: int | None,
    start: Startable | Start | None,
    num_steps: int | None,
    measures: Sequence[Measure],
    vmapped: bool = False,
) -> Callable[[], Run]:
    """What computes a run, after every argument was looked at."""
    num_episodes, bin_size, evaluate_every = check_arguments(env, learner, num_episodes, bin_size, evaluate_every)
    num_steps = checked_steps(num_steps)
    measures = checked_measures(measures)
    random.check_key(key)
    numbers = numbers_of(env, params)
    check_before_training(env, numbers, sample=not isinstance(key, Tracer))
    begin = None if start is None else checked_start(start, env, learner, num_episodes)
    learner = with_tabulated_schedules(learner, num_episodes, 0 if begin is None else begin.episodes)
    if measures:
        learner = Measured(learner, measures)
    trainer = (Lockstep if vmapped else Trainer)(env, learner, key, numbers, num_episodes, begin, num_steps)
    return partial(trainer.run, bin_size or default_bin_size(num_episodes), evaluate_every)


def checked_steps(num_steps: object) -> int | None:
    """A number of steps, or None; raises TypeError or ValueError for anything else."""
    return None if num_steps is None else checks.integer("num_steps", num_steps, 1, 2**63 - 1)


def check_arguments(
    env: object, learner: object, num_episodes: object, bin_size: object, evaluate_every: object
) -> tuple[int, int | None, int | None]:
    """Raises for what `train` could not run, naming the argument, the value and what is allowed.

    Returns:
        `num_episodes`, `bin_size` and `evaluate_every` as plain integers, or None where they were None.
    """
    forks.check_not_forked()
    env = checks.instance("env", env, Environment, "an environment such as hrljax.make('Bus')")
    learner = checks.instance("learner", learner, Learner, "a learner such as hrljax.QLearning()")
    check_declarations(env)
    if isinstance(env, TabularEnvironment):
        if env.num_states >= 1 << (30 - len(env.metrics)):
            raise ValueError(f"env has {env.num_states} states, too many to number them together with its events")
    elif learner.is_tabular:
        raise TypeError(f"env must be a tabular environment such as hrljax.make('Bus') for {learner.name}, got {env!r}")
    elif evaluate_every is not None:
        raise ValueError(f"evaluate_every needs a tabular environment, got {env!r}")
    return (
        checks.integer("num_episodes", num_episodes, 1),
        None if bin_size is None else checks.integer("bin_size", bin_size, 1),
        None if evaluate_every is None else checks.integer("evaluate_every", evaluate_every, 1),
    )
