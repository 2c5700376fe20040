"""Which spectrum belongs to which patch of a chart, by their names."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from usdskin.errors import LayerError
from usdskin.estimate.camera.measurements import Spectra, match_patches
from usdskin.estimate.chart.layouts import LAYOUTS

CHART = SimpleNamespace(where="chart.usda </Chart>")


def rows(camera: list[str], spectra: list[str], layout: str | None = None) -> list[int]:
    """Return the spectrum of each patch that has one."""
    measured = Spectra(tuple(spectra), np.zeros((len(spectra), 2)), None, "relative")
    known = None if layout is None else LAYOUTS[layout]
    pairs = match_patches(CHART, camera, len(camera), measured, known, [])
    assert pairs[0] == list(range(len(camera)))
    return pairs[1]


@pytest.mark.parametrize(
    "names",
    [
        ["赤", "緑", "青", "白"],
        ["+1", "-1", "0", "2"],
        ["a*", "A", "b", "c"],
        ["Hautton 1", "Hautton 10", "Hautton 1.0", "Ä"],
    ],
)
def test_names_in_any_script_and_order_pair_with_themselves(names):
    mixed = [names[k] for k in (2, 0, 3, 1)]
    assert rows(names, mixed) == [mixed.index(name) for name in names]


def test_names_pair_without_case_blanks_and_signs():
    assert rows(["Dark Skin", "ROUGE", "c-3"], ["c3", "dark_skin", "rouge"]) == [1, 2, 0]


def test_names_of_a_layout_pair_with_its_numbers():
    assert rows(["dark skin", "light skin"], ["A2", "A1"], "classic24") == [1, 0]


def test_patches_whose_names_cannot_be_told_apart_are_refused():
    with pytest.raises(LayerError, match='the spectra call patch 1 "P 1" and patch 2 "P-1", which'):
        rows(["p1", "q"], ["P 1", "P-1"])
    with pytest.raises(LayerError, match='the camera values call patch 1 "w" and patch 3 "w"'):
        rows(["w", "x", "w"], ["w", "x", "y"])
