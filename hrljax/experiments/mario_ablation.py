"""What moves the hybrid with a learned model, one change at a time: to the thesis's design, or to the best found."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from hrljax.envs.mario.env import Mario
from hrljax.experiments import mario_hybrid
from hrljax.experiments.mario_search import UNLIMITED
from hrljax.experiments.rows import Row
from hrljax.learners.relational.learned_model import MarioModel
from hrljax.learners.relational.learner import RelationalHORDQ
from hrljax.learners.relational.multiway_model import MultiwayModel
from hrljax.learners.relational.search_root import SearchRoot
from hrljax.sweeps.sweep import sweep


@dataclass(frozen=True)
class Change:
    """What differs from the thesis's design as it is read by default."""

    root: Mapping[str, Any] = field(default_factory=dict)
    model: Mapping[str, Any] = field(default_factory=dict)
    env: Mapping[str, Any] = field(default_factory=dict)
    params: Mapping[str, float] = field(default_factory=dict)

    def __or__(self, other: "Change") -> "Change":
        first, second = vars(self), vars(other)
        return Change(**{part: {**first[part], **second[part]} for part in first})

    def environment(self) -> Mario:
        return dataclasses.replace(mario_hybrid.environment(), **self.env)

    def search_root(self) -> SearchRoot:
        base = mario_hybrid.ROOTS["learned"]
        assert isinstance(base.model, MarioModel)
        return dataclasses.replace(base, model=dataclasses.replace(base.model, **self.model), **self.root)


GROWN_OUT = Change(model={"min_leaf": 1, "max_depth": 24, "rows": 60_000})
PLACE = Change(model={"offsets": True, "below": True})
LAST_REWARD = Change(root={"priority": "last_reward"})
LEAF = Change(root={"answer": "leaf"})
NO_STOP = Change(root={"stop_reward": UNLIMITED})
NODES = Change(root={"max_nodes": 1000})
PESSIMISM = Change(root={"max_nodes": 2000}, model={"pessimism": 0.5})

CHANGES = {
    "as read by default": Change(),
    "last reward first": LAST_REWARD,
    "answer: a leaf": LEAF,
    "300 nodes expanded": Change(root={"count": "expanded"}),
    "1000 nodes": NODES,
    "no stop at +6": NO_STOP,
    "sequences followed": Change(root={"follow": "sequence"}),
    "trees grown out": GROWN_OUT,
    "place in the tile": PLACE,
    "a death costs 10": Change(params={"death_reward": -10.0}),
    "quantum 16": Change(env={"quantum": 16}),
    "search: four together": LAST_REWARD | LEAF | NO_STOP | NODES,
    "trees: both together": GROWN_OUT | PLACE,
    "search and trees": LAST_REWARD | LEAF | NO_STOP | NODES | GROWN_OUT | PLACE,
    "these, 2000 nodes, pessimism": LAST_REWARD | LEAF | NO_STOP | GROWN_OUT | PLACE | PESSIMISM,
}


def _best(
    root: Mapping[str, Any] | None = None, model: Mapping[str, Any] | None = None, **learner: Any
) -> RelationalHORDQ:
    """The best configuration with a learned model, but for some settings."""
    base = mario_hybrid.ROOTS["remembers"]
    assert isinstance(base.model, MultiwayModel)
    changed = dataclasses.replace(base, model=dataclasses.replace(base.model, **(model or {})), **(root or {}))
    return dataclasses.replace(mario_hybrid.BEST_LEARNED, root=changed, **learner)


OF_BEST = {
    "as it is": _best(),
    "without memory": _best(model={"memory": False}),
    "nothing after a plan": _best(model={"death_decay": 0.0}),
    "no pessimism": _best(model={"pessimism": 0.0}),
    "any node answers": _best(root={"answer": "any"}),
    "300 nodes": _best(root={"max_nodes": 300}),
    "cumulative reward first": _best(root={"priority": "cumulative"}),
    "a bias for every action": _best(bias="own"),
    "no traces": _best(trace_length=0, trace_decay=0.0),
    "step size that fades": _best(step_size=mario_hybrid.BEST_VALUES.step_size),
}
"""What the best configuration with a learned model depends on, one change at a time."""


def names_of(of: Literal["thesis", "best"]) -> tuple[str, ...]:
    """The changes to the thesis's design, or to the best configuration with a learned model."""
    return tuple(CHANGES if of == "thesis" else OF_BEST)


def check_names(names: Iterable[str], of: Literal["thesis", "best"]) -> None:
    """Raises ValueError for a name that no change has."""
    for name in names:
        if name not in names_of(of):
            raise ValueError(f"there is no change {name!r}, only {', '.join(map(repr, names_of(of)))}")


def rows(
    names: Sequence[str],
    seeds: int,
    num_episodes: int,
    pseudo_reward: float = 10.0,
    of: Literal["thesis", "best"] = "thesis",
    **options: Any,
) -> Iterator[Row]:
    """What Model+HORDQ does with each of some `CHANGES` or of `OF_BEST`, as of `mario_hybrid.summary_row`.

    Ends after a row whose runs were interrupted. `pseudo_reward` is the thesis's; `options` are of `hrljax.sweep`.

    Raises:
        ValueError: there is no change of a name.
    """
    check_names(names, of)
    for name in names:
        if of == "best":
            change, learner = Change(), OF_BEST[name]
        else:
            change = CHANGES[name]
            learner = RelationalHORDQ(change.search_root(), pseudo_reward=pseudo_reward)
        env, axes = change.environment(), {f"env.{param}": [value] for param, value in change.params.items()}
        curves = sweep(
            env, learner, seeds=seeds, num_episodes=num_episodes, bin_size=1, chunk_size=1, axes=axes, **options
        )
        yield mario_hybrid.summary_row(name, curves.squeeze(list(axes)))
        if not curves.attrs["complete"]:
            return


def table(rows: Sequence[Row]) -> str:
    """The rows as text."""
    lines = [f"{'':30}{'levels finished':>16}{'distance':>10}{'steps':>9}"]
    for row in rows:
        numbers = f"{row['finished']['mean']:16.1f}{row['distance']['mean']:10.1f}{row['steps']:9.0f}"
        lines.append(f"{row['name']:30}{numbers}")
    lines.append(f"of {rows[0]['episodes']} episodes, mean of {rows[0]['seeds']} seeds; distance in tiles")
    return "\n".join(lines)
