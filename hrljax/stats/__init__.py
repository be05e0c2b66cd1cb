"""Statistics of results over seeds: labelled arrays in, labelled arrays out, unfinished runs (NaN) left out.

From curves to one number a run (`curves`), from runs to numbers with intervals (`intervals`, `resampling`), from two
learners to how they compare (`comparisons`), from many settings to the best (`selection`), to a table (`tables`).
"""

from hrljax.stats.comparisons import paired_differences, probability_of_improvement
from hrljax.stats.curves import against_steps, area_under_curve, episode_range, episodes_to_reach, smoothed
from hrljax.stats.intervals import bootstrap_interval, estimate, interquartile_mean, mean, mean_interval
from hrljax.stats.resampling import Method, Statistic
from hrljax.stats.selection import best
from hrljax.stats.tables import Table, table

__all__ = [
    "Method",
    "Statistic",
    "Table",
    "against_steps",
    "area_under_curve",
    "best",
    "bootstrap_interval",
    "episode_range",
    "episodes_to_reach",
    "estimate",
    "interquartile_mean",
    "mean",
    "mean_interval",
    "paired_differences",
    "probability_of_improvement",
    "smoothed",
    "table",
]
