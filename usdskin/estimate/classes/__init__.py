"""Which lamp lights what, where a scene has lamps of several kinds."""

from __future__ import annotations

from usdskin.estimate.classes.lamps import read_lamps
from usdskin.estimate.classes.maps import read_class_map, write_class_map
from usdskin.estimate.classes.report import ClassReport, report_classes
from usdskin.estimate.classes.weights import estimate_class_weights

__all__ = [
    "ClassReport",
    "estimate_class_weights",
    "read_class_map",
    "read_lamps",
    "report_classes",
    "write_class_map",
]
