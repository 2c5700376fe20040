"""Connected regions of a latlong map: texels that touch, across the seam and around the poles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray


def label_regions(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the number of each texel's region, 0 outside of regions, shape [height, width].

    Texels touch along edges and at corners; all those of the first row meet at the pole, and so do
    those of the last.

    Args:
        mask: Which texels belong to regions, shape [height, width].
    """
    import cv2

    count, found = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    labels: NDArray[np.int32] = np.asarray(found, dtype=np.int32)
    left, right = labels[:, 0], labels[:, -1]
    pairs = [(left, right), (left[1:], right[:-1]), (left[:-1], right[1:])]
    for pole in (labels[0], labels[-1]):
        around = pole[pole > 0]
        pairs.append((around[:-1], around[1:]))
    parent = np.arange(count)

    def root(label: int) -> int:
        while parent[label] != label:
            label = int(parent[label])
        return label

    for one, other in pairs:
        touching = (one > 0) & (other > 0) & (one != other)
        for a, b in zip(one[touching].tolist(), other[touching].tolist(), strict=True):
            first, second = sorted((root(a), root(b)))
            parent[second] = first
    return np.array([root(label) for label in range(count)], dtype=np.int32)[labels]


def region_texels(
    labels: NDArray[np.int32],
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield the rows and the columns of each region's texels, in the order of their first texels.

    Args:
        labels: What ``label_regions`` returns, shape [height, width].
    """
    places = np.flatnonzero(labels)
    found = labels.ravel()[places]
    order = np.argsort(found, kind="stable")
    ends = np.flatnonzero(np.diff(found[order])) + 1
    regions = np.split(places[order], ends) if places.size else []
    for texels in sorted(regions, key=lambda region: int(region[0])):
        yield texels // labels.shape[1], texels % labels.shape[1]
