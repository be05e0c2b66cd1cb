"""Bus domains that were not used to choose any setting."""

LOOP = """\
+---+---+---+---+---+---+---+
| 1   1   1 | 2   2   2   2P|
+           +               +
| 1S  1   1   2   2   2   2 |
+   +---+---+---+---+---+ A +
| 3   3 | 4   4   4 | 5   5 |
+       +           +       +
| 3   3   4   4   4   5   5P|
+       +           +       +
| 3P  3 | 4   4   4 B 5   5 |
+---+---+---+---+---+---+---+
"""
"""Five areas in a ring; one site on the short way, one on a door that has another beside it."""

CORRIDOR = """\
+---+---+---+---+---+---+---+---+
| 1   1 | 2   2 | 3   3 | 4   4P|
+       +       +       +       +
| 1P  1 A 2   2   3   3 B 4   4 |
+   +   +---+   +   +---+   +---+
| 5   5   5   5 | 6   6   6   6 |
+               +               +
| 5   5   5S  5   6   6   6P  6 |
+---+---+---+---+---+---+---+---+
"""
"""Six areas; rooms above a corridor of two halves, with a site on every second passage."""
