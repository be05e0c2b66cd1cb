"""The random number generator of Java's standard library, which the level generator draws from."""

_MULTIPLIER = 0x5DEECE66D
_INCREMENT = 0xB
_MASK = (1 << 48) - 1
_INT_RANGE = 1 << 31


class JavaRandom:
    """``java.util.Random``: a linear congruential generator of 48 bits.

    Args:
        seed: as Java's long; negative ones are sign-extended, as Java does with an int.
    """

    def __init__(self, seed: int):
        self._state = (seed ^ _MULTIPLIER) & _MASK

    def below(self, bound: int) -> int:
        """A whole number in ``[0, bound)``: Java's ``nextInt(bound)``, for `bound` in 1..2^31 - 1."""
        drawn = self._bits()
        if bound & (bound - 1) == 0:
            return bound * drawn >> 31
        # The last, incomplete stretch of `bound` numbers is drawn again, so that all are equally likely.
        while drawn - drawn % bound + bound > _INT_RANGE:
            drawn = self._bits()
        return drawn % bound

    def _bits(self) -> int:
        self._state = (self._state * _MULTIPLIER + _INCREMENT) & _MASK
        return self._state >> 17
