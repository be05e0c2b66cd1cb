"""How the engine is compiled as a native loop on a CPU."""

from hrljax import xla


def engine_options() -> dict[str, str | bool | int] | None:
    """Compiler options of a native loop over ticks; None where there are no native loops.

    Those of `hrljax.xla.OPTIONS` but the region analysis of copies: with it, XLA drops copies that
    the engine's nested loops need, and values are read after they were overwritten.
    """
    if not xla.native_loops_available():
        return None
    return {name: value for name, value in xla.OPTIONS.items() if "region_analysis" not in name}
