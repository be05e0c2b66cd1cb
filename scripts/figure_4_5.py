"""The distance that Mario moves in each episode (thesis Figure 4.5), from the runs of table_4_1.py."""

import json
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.experiments import mario_hybrid, program
from hrljax.experiments.rows import curves_csv
from hrljax.sweeps import io


@dataclass(frozen=True)
class Options:
    """Distance by episode (thesis Figure 4.5): a picture and a CSV of the methods chosen.

    Reads what scripts/table_4_1.py wrote, one run for both. Writes figure_4_5.png, figure_4_5.csv and
    summary.json, the rows of those methods.
    """

    runs: Path = Path("runs/table_4_1")
    """Where table_4_1.py wrote."""
    methods: tuple[str, ...] = tuple(mario_hybrid.THESIS)
    """Names of methods, such as "SARSA" or "Model+HORDQ(5)"."""
    out: Path = Path("runs/figure_4_5")
    """Folder for what is written."""


def main(options: Options) -> int:
    summary = options.runs / "summary.json"
    if not summary.exists():
        raise ValueError(f"--runs: there is no {summary}; run scripts/table_4_1.py --out {options.runs} first")
    rows = json.loads(summary.read_text())
    names = [row["name"] for row in rows]
    for name in options.methods:
        if name not in names:
            raise ValueError(f"--methods must be among {', '.join(names)}, got {name!r}")
    stores = {name: options.runs / "curves" / f"{names.index(name):02d}.zarr" for name in options.methods}
    curves = dict(program.until_interrupted((name, io.load(store)) for name, store in stores.items()))
    if not curves:
        return program.ended(options.out)
    options.out.mkdir(parents=True, exist_ok=True)
    mario_hybrid.distance_picture(curves).savefig(options.out / "figure_4_5.png", dpi=110)
    (options.out / "figure_4_5.csv").write_text(curves_csv(("", name, curve) for name, curve in curves.items()))
    chosen = [row for row in rows if row["name"] in options.methods]
    program.write_summary(options.out, chosen)
    print(mario_hybrid.table(chosen))
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
