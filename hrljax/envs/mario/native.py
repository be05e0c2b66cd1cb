"""How the engine is compiled as a native loop on a CPU."""

from hrljax import xla


def engine_options() -> dict[str, str | bool | int] | None:
    """Compiler options of a native loop over ticks; None where there are no native loops.

    Those of `hrljax.xla.OPTIONS` without the region analysis of copies. With it, XLA (jaxlib 0.10.2)
    drops copies that nested loops need: an outer loop's counter is overwritten while an inner loop
    still reads it, and of two writes to one array the second sees the first in values that were read
    before. Then sprites differ from the recordings, which the parity tests would show. A loop that
    holds this engine, a learner's too, must be compiled with these options.
    """
    if not xla.native_loops_available():
        return None
    return {name: value for name, value in xla.OPTIONS.items() if "region_analysis" not in name}
