"""Which of the details that the thesis leaves open moves the hybrid with a learned model: one change at a time."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hrljax.envs.mario.env import Mario
from hrljax.experiments import mario_hybrid
from hrljax.experiments.mario_search import UNLIMITED
from hrljax.experiments.rows import Row
from hrljax.learners.relational.learned_model import MarioModel
from hrljax.learners.relational.learner import RelationalHORDQ
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


def check_names(names: Iterable[str]) -> None:
    """Raises ValueError for a name that no change has."""
    for name in names:
        if name not in CHANGES:
            raise ValueError(f"there is no change {name!r}, only {', '.join(map(repr, CHANGES))}")


def rows(
    names: Sequence[str], seeds: int, num_episodes: int, pseudo_reward: float = 10.0, **options: Any
) -> Iterator[Row]:
    """What Model+HORDQ does with each of some `CHANGES`, as of `mario_hybrid.summary_row`.

    Ends after a row whose runs were interrupted. `options` are of `hrljax.sweep`.

    Raises:
        ValueError: there is no change of a name.
    """
    check_names(names)
    for name in names:
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
