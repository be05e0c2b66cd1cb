"""Pictures of `learning_rates`. Results are datasets by domain and learner."""

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrljax import plots, stats
from hrljax.experiments.learning_rates import best
from hrljax.plots import style

Results = dict[str, dict[str, xr.Dataset]]


def pictures(results: Results, values: dict[str, dict[str, float]]) -> dict[str, Figure]:
    """All pictures by name, of what has finished; none if nothing has.

    Args:
        results: datasets of `learning_rates.run` by domain and learner.
        values: those of `learning_rates.exact` by domain.
    """
    finished = {
        domain: {name: dataset for name, dataset in datasets.items() if dataset["mean_return"].notnull().any()}
        for domain, datasets in results.items()
    }
    shown = {domain: datasets for domain, datasets in finished.items() if datasets}
    if not shown:
        return {}
    figures = {"sensitivity": sensitivity(shown, values), "intervals": intervals(shown, values)}
    return figures | ({"heat_maps": heat_maps(shown)} if _hierarchical(shown) else {})


def heat_maps(results: Results) -> Figure:
    """Mean return over step size and pseudo-reward of every hierarchical learner, a row for each domain."""
    names = _hierarchical(results)
    figure = Figure(figsize=(6.6 * len(names), 3.5 * len(results)), layout="constrained")
    panels = figure.subplots(len(results), len(names), squeeze=False)
    for (domain, datasets), row in zip(results.items(), panels, strict=True):
        shown = {name: datasets[name]["mean_return"] for name in names if name in datasets}
        means = [stats.estimate(values, "mean") for values in shown.values()]
        for name, ax in zip(names, row, strict=False):
            if name in shown:
                limits = float(min(m.min() for m in means)), float(max(m.max() for m in means))
                plots.heat_map(
                    shown[name], "step_size", "pseudo_reward", limits=limits, title=f"{domain}: {name}", ax=ax
                )
            else:
                ax.set_axis_off()
    return figure


def sensitivity(results: Results, values: dict[str, dict[str, float]]) -> Figure:
    """Mean return against step size: learners at their best pseudo-reward above, HORDQ at each of them below."""
    figure = Figure(figsize=(5.6 * len(results), 8.6), layout="constrained")
    panels = figure.subplots(2, len(results), squeeze=False, sharex="col", sharey="col")
    for number, (domain, datasets) in enumerate(results.items()):
        references = {"best epsilon-soft": values[domain]["epsilon_soft"]}
        learners = dict(_at_best_pseudo_reward(name, dataset) for name, dataset in datasets.items())
        above, below = panels[:, number]
        plots.sensitivity(learners, "step_size", references=references, ax=above)
        above.set_title(domain)
        above.set_xlabel("")
        if "HORDQ" in datasets:
            plots.sensitivity(
                {"HORDQ": datasets["HORDQ"]["mean_return"]},
                "step_size",
                lines="pseudo_reward",
                references=references,
                ax=below,
            )
        else:
            below.set_axis_off()
    return figure


def intervals(results: Results, values: dict[str, dict[str, float]]) -> Figure:
    """Mean and interquartile mean of every learner at its best setting."""
    figure = Figure(figsize=(9.6, 2.5 * len(results)), layout="constrained")
    panels: list[Axes] = list(figure.subplots(len(results), 1, squeeze=False)[:, 0])
    for (domain, datasets), ax in zip(results.items(), panels, strict=True):
        chosen = {}
        for name, dataset in datasets.items():
            setting = best(dataset)
            described = ", ".join(f"{style.readable(key)} {value:g}" for key, value in setting.items())
            chosen[f"{name}, {described}"] = dataset["mean_return"].sel(setting, drop=True)
        plots.intervals(chosen, references={"best epsilon-soft": values[domain]["epsilon_soft"]}, ax=ax)
        ax.set_title(domain, loc="right")
    return figure


def _hierarchical(results: Results) -> list[str]:
    """Learners with a pseudo-reward, in their order."""
    named = (
        name for datasets in results.values() for name, dataset in datasets.items() if "pseudo_reward" in dataset.dims
    )
    return list(dict.fromkeys(named))


def _at_best_pseudo_reward(name: str, dataset: xr.Dataset) -> tuple[str, xr.DataArray]:
    setting = best(dataset)
    if "pseudo_reward" not in setting:
        return name, dataset["mean_return"]
    chosen = setting["pseudo_reward"]
    return f"{name}, pseudo-reward {chosen:g}", dataset["mean_return"].sel(pseudo_reward=chosen, drop=True)
