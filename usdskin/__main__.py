"""``python -m usdskin``."""

from __future__ import annotations

import sys

from usdskin.cli import main

if __name__ == "__main__":
    sys.exit(main())
