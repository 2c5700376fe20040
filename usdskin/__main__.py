"""``python -m usdskin``."""

from __future__ import annotations

from usdskin.cli import run

if __name__ == "__main__":
    run()
