"""Pairs of keys that a list of scenes covers."""

import itertools


def pairs_not_covered(rows, keys, fits):
    """The pairs ((key, value), (key, value)) of `keys` that no row has, without elements that fit no curtain."""
    seen = {pair for row in rows for pair in itertools.combinations(row.items(), 2)}
    return [
        ((a, x), (b, y))
        for a, b in itertools.combinations(keys, 2)
        for x, y in itertools.product(keys[a], keys[b])
        if ({a, b} != {"curtain", "element"} or fits({"curtain": x, "element": y})) and ((a, x), (b, y)) not in seen
    ]
