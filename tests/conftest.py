"""Fixtures and options every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--warp-debug``: kernels with bounds checks, in a cache of their own."""
    parser.addoption("--warp-debug", action="store_true", help="run Warp kernels in debug mode")


def pytest_configure(config: pytest.Config) -> None:
    """Set Warp up before any kernel module is imported."""
    if config.getoption("--warp-debug"):
        import warp as wp

        wp.config.mode = "debug"
        wp.config.enable_tiles_in_stack_memory = False  # as open_workers sets it


def _devices() -> list[str]:
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    return ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run every test that takes ``device`` on the CPU, and on a GPU where there is one."""
    if "device" in metafunc.fixturenames:
        metafunc.parametrize("device", _devices())


@pytest.fixture(scope="session")
def realdata() -> Path:
    """Return the folder of the evaluation data, or skip, saying so."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("USDSKIN_REALDATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no evaluation data at {folder}; set USDSKIN_REALDATA to its folder")
    return folder
