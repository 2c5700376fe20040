"""Fixtures every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def realdata() -> Path:
    """Return the folder of the evaluation data, or skip, saying so."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("USDSKIN_REALDATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no evaluation data at {folder}; set USDSKIN_REALDATA to its folder")
    return folder
