"""A Bus domain small enough to compile and solve in a moment, with everything that the large one has."""

import hrljax

SMALL = hrljax.make(
    "Bus",
    map="""\
+---+---+---+---+
| 1   1P| 2   2 |
+   +   +   +   +
| 1S  1 A 2   2P|
+---+   +---+ B +
| 3   3   4   4 |
+---+---+---+---+
""",
)
