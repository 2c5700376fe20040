"""Opening a stage for its reader: checked first, and told apart from the reader's own mistakes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from usdskin.layers import corruption_as_errors, open_stage, quiet_diagnostics
from usdskin.notes import Note
from usdskin.prims import check_stage_schemas
from usdskin.render.overrides import RenderOverrides, apply_overrides

# isort: split
# After ours, which register the schemas.
from pxr import Usd


@contextmanager
def opened(path: Path, overrides: RenderOverrides, notes: list[Note]) -> Iterator[Usd.Stage]:
    """Give a stage whose applied schemas are all known; what breaks while it is read is an error.

    Args:
        path: Layer to open; it is read, never changed.
        overrides: What flags say of its variants and attributes.
        notes: Takes what does not compose.

    Raises:
        LayerError: The layer cannot be opened or read, or a schema's name is misspelt.
        UsageError: A flag names what the stage has not.
    """
    with corruption_as_errors(path), quiet_diagnostics():
        stage = open_stage(path, notes, lambda stage: apply_overrides(stage, overrides))
        check_stage_schemas(stage)
        yield stage
