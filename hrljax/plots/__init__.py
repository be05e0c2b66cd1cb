"""Pictures of results. Figures are made without pyplot: no display, no global state."""

from hrljax.hierarchy.drawing import draw as task_graph
from hrljax.hierarchy.drawing import draw_completion as completion
from hrljax.plots.comparisons import intervals
from hrljax.plots.curves import learning_curves
from hrljax.plots.maps import policy, state, value
from hrljax.plots.style import COLOURS
from hrljax.plots.sweeps import heat_map, sensitivity

__all__ = [
    "COLOURS",
    "completion",
    "heat_map",
    "intervals",
    "learning_curves",
    "policy",
    "sensitivity",
    "state",
    "task_graph",
    "value",
]
