"""Tables in Markdown and LaTeX."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from hrljax import stats


def runs(*values: float) -> xr.DataArray:
    return xr.DataArray(list(values), {"seed": np.arange(len(values))}, ("seed",))


ONE, TWO = runs(1, 2, 3), runs(10, 10, 16)
REACH = 4.302652729749464 / 3**0.5  # Student's quantile of two degrees of freedom, over the root of three runs


def test_a_row_a_learner_and_the_best_in_bold():
    table = stats.table({"MAXQ": ONE, "HORDQ": TWO}, best="greatest")
    assert table.columns == ("mean",)
    (cell,) = table.rows["MAXQ"]
    np.testing.assert_allclose(cell[:3], [2, 2 - REACH, 2 + REACH])
    assert table.markdown() == "\n".join(
        ["|  | mean |", "| --- | ---: |", "| MAXQ | 2.00 [-0.48, 4.48] |", "| HORDQ | **12.00** [3.39, 20.61] |"]
    )
    assert repr(table) == table._repr_markdown_() == table.markdown()
    assert "**2.00**" in stats.table({"MAXQ": ONE, "HORDQ": TWO}, best="least").markdown()
    assert "**" not in stats.table({"MAXQ": ONE, "HORDQ": TWO}).markdown()


def test_a_column_a_task_as_latex():
    values = {"R_max & 5%": {"Bus": ONE, "Taxi^2": TWO}, r"a\b": {"Bus": TWO, "Taxi^2": ONE}}
    assert stats.table(values, best="greatest", digits=1).latex() == "\n".join(
        [
            r"\begin{tabular}{lrr}",
            r"\toprule",
            r"& Bus & Taxi\textasciicircum{}2 \\",
            r"\midrule",
            r"R\_max \& 5\% & $2.0 [-0.5, 4.5]$ & $\mathbf{12.0} [3.4, 20.6]$ \\",
            r"a\textbackslash{}b & $\mathbf{12.0} [3.4, 20.6]$ & $2.0 [-0.5, 4.5]$ \\",
            r"\bottomrule",
            r"\end{tabular}",
        ]
    )


def test_columns_may_be_values_of_a_dimension():
    swept = xr.concat([ONE, TWO], "step_size").assign_coords(step_size=[0.1, 0.5])
    table = stats.table({"Q-learning": swept}, "median", level=0.5)
    assert table.columns == ("step_size=0.1", "step_size=0.5")
    assert [cell.value for cell in table.rows["Q-learning"]] == [2, 10]
    low, high = (float(stats.bootstrap_interval(TWO, "median", level=0.5)[end]) for end in ("low", "high"))
    assert table.rows["Q-learning"][1][1:3] == (low, high)


def test_columns_of_points_have_the_names_of_their_hyper_parameters():
    points = xr.concat([ONE, TWO], "point").assign_coords(
        step_size=("point", [0.1, 0.5]), epsilon=("point", [0.2, 0.1])
    )
    assert stats.table({"MAXQ": points}).columns == ("step_size=0.1, epsilon=0.2", "step_size=0.5, epsilon=0.1")


def test_what_is_missing_or_infinite_has_no_interval_and_wins_nothing():
    table = stats.table({"a | b": runs(np.nan, np.nan), "c": runs(np.inf, np.inf), "d": runs(3.0)}, best="least")
    assert table.markdown().splitlines()[2:] == [r"| a \| b | nan |", "| c | inf |", "| d | **3.00** |"]


def test_of_one_array_every_setting_is_a_row():
    swept = xr.concat([ONE, TWO], "step_size").assign_coords(step_size=[0.1, 0.5])
    table = stats.table(swept, best="greatest")
    assert table == stats.table({"step_size=0.1": ONE, "step_size=0.5": TWO}, best="greatest")


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: stats.table(ONE), TypeError, "values must be a mapping"),  # type: ignore[arg-type]
        (lambda: stats.table(ONE.to_dataset(name="return")), TypeError, "values must be one variable of a dataset"),
        (
            lambda: stats.table({"a": ONE.to_dataset(name="return")}),  # type: ignore[dict-item]
            TypeError,
            "values: 'a' must be one variable of a dataset, such as curves",
        ),
        (lambda: stats.table({}), ValueError, "at least one array"),
        (lambda: stats.table({"a": {}}), ValueError, "at least one array"),
        (lambda: stats.table({"a": ONE, "b": {"Bus": ONE}}), ValueError, "all rows must have the columns"),
        (lambda: stats.table({"a": ONE.expand_dims(x=[1], y=[2])}), ValueError, "one dimension besides 'seed'"),
        (lambda: stats.table({"a": {"Bus": ONE.expand_dims(x=[1])}}), ValueError, "no dimension besides 'seed'"),
        (lambda: stats.table({"a": ONE}, best="most"), ValueError, "best must be one of"),  # type: ignore[arg-type]
        (lambda: stats.table({"a": ONE}, digits=-1), ValueError, "digits must be"),
        (lambda: stats.table({"a": ONE}, level=95), ValueError, "perhaps 0.95 is meant"),
    ],
)
def test_bad_arguments(make: Callable[[], stats.Table], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        make()
