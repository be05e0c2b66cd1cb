"""Learning curves of the Bus domain (thesis Figure 4.2): a picture, a table and the numbers."""

import sys
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.engine.batch import Mapping
from hrljax.experiments import figure_4_2, program
from hrljax.experiments.rows import curves_csv
from hrljax.sweeps import io


@dataclass(frozen=True)
class Options:
    """Learning curves of the Bus domain (thesis Figure 4.2).

    Writes figure_4_2.png, figure_4_2.csv, summary.json and, for every curve, a Zarr store. summary.json
    holds "exact" (expected returns by dynamic programming: "optimal" by road status and its "mean",
    "blind", "avoid", "no_sites", "epsilon_soft") and "curves" (for each: "name", "panel",
    "mean_return" with "ci95", "bins" with "from", "to", "mean", "lo", "hi", "damage_per_episode" in
    the last bin, "truncated_per_episode", "steps_per_second", "seconds", "compile_seconds").
    """

    seeds: int = 200
    """Runs of each curve."""
    episodes: int = 20_000
    """Episodes of each run."""
    out: Path = Path("runs/figure_4_2")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    mapping: Mapping = "auto"
    """How runs are mapped: native loops on CPUs, vmap elsewhere."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds", "episodes")
    options.out.mkdir(parents=True, exist_ok=True)
    exact = figure_4_2.exact()
    finished, rows = [], []
    curves = figure_4_2.run(options.seeds, options.episodes, options.cores, options.mapping, options.key)
    for curve, dataset in program.until_interrupted(curves):
        finished.append((curve, dataset))
        rows.append(figure_4_2.summary_row(curve, dataset))
        io.save(dataset, options.out / "curves" / f"{len(rows):02d}.zarr")
        row = rows[-1]
        print(f"{row['name']:>36} {row['mean_return']:8.2f}  {row['seconds']:6.1f} s", file=sys.stderr, flush=True)
    program.write_summary(options.out, {"exact": exact, "curves": rows})
    (options.out / "figure_4_2.csv").write_text(
        curves_csv((curve.panel, curve.name, dataset) for curve, dataset in finished)
    )
    figure_4_2.picture(finished, exact).savefig(options.out / "figure_4_2.png", dpi=110)
    print(figure_4_2.table(rows))
    print(f"\noptimum {exact['optimal']['mean']:.2f}, best epsilon-soft policy {exact['epsilon_soft']:.2f}")
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
