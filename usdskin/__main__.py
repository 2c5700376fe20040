"""``python -m usdskin`` and the script ``usdskin``: a process that hears Ctrl-C from its start."""

from __future__ import annotations

from usdskin.stops import Stops

TYPE_CHECKING = False  # as typing has it, which takes long to load
if TYPE_CHECKING:
    from typing import NoReturn


def run() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    stops = Stops()
    stops.hear(last=True)
    from usdskin import cli

    cli.run(stops)


if __name__ == "__main__":
    run()
