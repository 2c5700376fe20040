"""Which patches of a chart a figure shows."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError

FloatArray = NDArray[np.float64]

_FIRST = ("light skin", "dark skin")


def choose_patches(
    names: Sequence[str], lab: FloatArray, wanted: Sequence[str] = (), count: int = 12
) -> list[int]:
    """Return the patches to show, in the chart's order or the one asked for.

    Where nothing is asked for, those are skin, where the chart names it, and then again and again
    the patch that differs most from those before: a dozen shows what the chart holds.

    Args:
        names: The chart's patches.
        lab: What they look like, L*, a*, b*, shape [patch_count, 3].
        wanted: Names asked for, capital letters or not; their first words where those are enough.
        count: How many to choose where none are asked for.

    Returns:
        Indices into ``names``.

    Raises:
        UsageError: The chart has no patch of that name, or several that begin so.
    """
    if wanted:
        return [_index(name, names) for name in wanted]
    known = {name.strip().lower(): index for index, name in enumerate(names)}
    chosen = [known[name] for name in _FIRST if name in known]
    if not chosen:
        chosen = [int(np.argmax(lab[:, 0]))]
    while len(chosen) < min(count, len(names)):
        distance = np.linalg.norm(lab[:, None] - lab[chosen], axis=-1).min(axis=1)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return sorted(chosen)


def _index(name: str, names: Sequence[str]) -> int:
    plain = [item.strip().lower() for item in names]
    key = name.strip().lower()
    if key in plain:
        return plain.index(key)
    # "white" is enough for "white 9.5 (.05 D)".
    begin = [index for index, item in enumerate(plain) if item.startswith(f"{key} ")]
    if len(begin) == 1:
        return begin[0]
    close = difflib.get_close_matches(key, plain, n=3)
    shown = [names[plain.index(item)] for item in close] or [*names[:6], "..."]
    raise UsageError(f"--patches {name}: the chart has no such patch; it has {', '.join(shown)}")
