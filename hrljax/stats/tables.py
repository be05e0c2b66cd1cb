"""Tables for papers and notes: a statistic of every learner with its interval, in Markdown and LaTeX."""

import re
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import xarray as xr

from hrljax.core import checks
from hrljax.stats.arguments import check_level, check_named, check_values
from hrljax.stats.intervals import bootstrap_interval, mean_interval
from hrljax.stats.resampling import Statistic
from hrljax.stats.settings import settings

Best: TypeAlias = Literal["greatest", "least"] | None
_SPECIAL = re.compile(r"[&%$#_{}]")
_SPELT_OUT = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}


class Cell(NamedTuple):
    """A statistic with its interval, and whether it is the best of its column."""

    value: float
    low: float
    high: float
    is_best: bool


class Table(NamedTuple):
    """What `table` makes; shows itself as Markdown."""

    columns: tuple[str, ...]
    rows: dict[str, tuple[Cell, ...]]  # by name, a cell a column
    digits: int  # behind the point

    def markdown(self) -> str:
        """As Markdown, such as ``| HORDQ | -38.70 [-39.10, -38.30] |``; the best is bold."""
        lines = [["", *self.columns], ["---"] + ["---:"] * len(self.columns)]
        for name, cells in self.rows.items():
            lines.append([name.replace("|", r"\|"), *(self._text(cell, "**{}**") for cell in cells)])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def latex(self) -> str:
        r"""As a ``tabular`` of LaTeX, for the package booktabs; the best is bold."""
        lines = [["", *map(_escaped, self.columns)]]
        lines += [
            [_escaped(name), *(f"${self._text(cell, chr(92) + 'mathbf{{{}}}')}$" for cell in cells)]
            for name, cells in self.rows.items()
        ]
        head, *body = (" & ".join(line).lstrip() + r" \\" for line in lines)
        begin = rf"\begin{{tabular}}{{l{'r' * len(self.columns)}}}"
        return "\n".join([begin, r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"])

    def _text(self, cell: Cell, bold: str) -> str:
        value, low, high = (f"{number:.{self.digits}f}" for number in cell[:3])
        shown = bold.format(value) if cell.is_best else value
        return f"{shown} [{low}, {high}]" if np.isfinite([cell.low, cell.high]).all() else shown

    def __repr__(self) -> str:
        return self.markdown()

    def _repr_markdown_(self) -> str:
        """What notebooks show."""
        return self.markdown()


def table(
    values: xr.DataArray | Mapping[str, xr.DataArray | Mapping[str, xr.DataArray]],
    statistic: Statistic = "mean",
    *,
    best: Best = None,
    digits: int = 2,
    level: float = 0.95,
) -> Table:
    """A table of a statistic over runs with its interval: Student's of the mean, the percentile bootstrap's of others.

    Args:
        values: by the name of a row, one number a run, with the dimension ``seed`` and perhaps one more, whose values
            become columns; or several by the names of columns. Or one array of a sweep: a row is a setting.
        statistic: ``"mean"``, ``"interquartile_mean"`` or ``"median"``.
        best: which number of each column is bold.
        digits: behind the point, from 0.
        level: coverage of the intervals, in (0, 1).

    Returns:
        The table. It shows itself as Markdown; `Table.markdown` and `Table.latex` give text. A cell without an
        interval had fewer than two runs.

    Raises:
        TypeError, ValueError: a bad argument, more dimensions, or rows with different columns.
    """
    if isinstance(values, xr.DataArray) and values.ndim > 1:
        check_values("values", values, "seed")
        values = {setting: runs for runs, setting in settings(values, "seed")}
    check_named("values", values, "a mapping from names of rows to DataArrays, or a DataArray with several settings")
    checks.choice("statistic", statistic, Statistic)
    checks.choice("best", best, ("greatest", "least", None))
    checks.integer("digits", digits, 0, 15)
    check_level(level)
    rows = {name: dict(_columns(name, of_row, statistic)) for name, of_row in values.items()}
    columns = tuple(next(iter(rows.values()), {}))
    if not columns:
        raise ValueError("values must hold at least one array, got none")
    for name, row in rows.items():
        if tuple(row) != columns:
            raise ValueError(f"values: all rows must have the columns {columns}, got {tuple(row)} of {name!r}")
    intervals = {name: [_interval(runs, statistic, level) for runs in row.values()] for name, row in rows.items()}
    is_best = _best(np.array([[cell[0] for cell in row] for row in intervals.values()]), best)
    cells = {
        name: tuple(Cell(*cell, bool(flag)) for cell, flag in zip(row, flags, strict=True))
        for (name, row), flags in zip(intervals.items(), is_best, strict=True)
    }
    return Table(columns, cells, digits)


def _best(numbers: np.ndarray, best: Best) -> np.ndarray:
    """``[rows, columns]`` bool: which numbers are the best of their columns; NaN ones are not."""
    if best is None:
        return np.zeros(numbers.shape, np.bool_)
    signed = np.where(np.isnan(numbers), -np.inf, numbers if best == "greatest" else -numbers)
    return (signed == signed.max(0)) & ~np.isnan(numbers)


def _columns(
    name: str, of_row: xr.DataArray | Mapping[str, xr.DataArray], statistic: Statistic
) -> Iterator[tuple[str, xr.DataArray]]:
    """Names of columns, and the runs of each."""
    if isinstance(of_row, Mapping):
        check_named(f"values: {name!r}", of_row, "a mapping from names of columns to DataArrays")
        for column, runs in of_row.items():
            _check_runs(f"values: {name!r}: {column!r}", runs)
            yield column, runs
        return
    check_values(f"values: {name!r}", of_row, "seed")
    more = [dim for dim in of_row.dims if dim != "seed"]
    if not more:
        yield statistic.replace("_", " "), of_row
        return
    if len(more) > 1:
        named = ", ".join(map(str, more))
        raise ValueError(f"values: {name!r} must have one dimension besides 'seed' at most, got {named}")
    for runs, setting in settings(of_row, "seed"):
        yield setting, runs


def _check_runs(what: str, runs: xr.DataArray) -> None:
    check_values(what, runs, "seed")
    if len(runs.dims) > 1:
        raise ValueError(f"{what} must have no dimension besides 'seed', got {', '.join(map(str, runs.dims))}")


def _interval(runs: xr.DataArray, statistic: Statistic, level: float) -> tuple[float, float, float]:
    if statistic == "mean" and np.isfinite(runs.where(runs.notnull(), 0)).all():
        interval = mean_interval(runs, level=level)
    else:
        interval = bootstrap_interval(runs, statistic, level=level)
    return float(interval[statistic]), float(interval["low"]), float(interval["high"])


def _escaped(text: str) -> str:
    """Text as LaTeX writes it."""
    return "".join(_SPELT_OUT.get(letter) or _SPECIAL.sub(r"\\\g<0>", letter) for letter in text)
