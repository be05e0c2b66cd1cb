"""How the engine is compiled as a native loop on a CPU."""

from hrljax import xla


def engine_options() -> dict[str, str | bool | int] | None:
    """Compiler options of a native loop over ticks; None where there are no native loops.

    `hrljax.xla.NESTED_OPTIONS`: with the others sprites differ from the recordings, which the parity
    tests would show. A loop that holds this engine, a learner's too, must be compiled with these.
    """
    if not xla.native_loops_available():
        return None
    return dict(xla.NESTED_OPTIONS)
