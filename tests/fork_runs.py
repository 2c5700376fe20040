"""Run ``usdskin`` commands in child processes that share one import; a program of its own.

Reads a line of JSON per command on stdin, ``{"arguments": [...], "seconds": s, "bytes": b}``, and
writes one per command: what it exited with (negative: the signal), and what it printed.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import tempfile
import time


def run(arguments: list[str], seconds: float, memory_bytes: int) -> dict[str, object]:
    """Return what one command did, with a time limit [s] and an address space limit."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as error:
        begun = time.monotonic()
        child = os.fork()
        if child == 0:
            os.dup2(out.fileno(), 1)
            os.dup2(error.fileno(), 2)
            resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            signal.setitimer(signal.ITIMER_REAL, seconds)  # SIGALRM ends a process by itself
            code = 1
            try:
                code = cli.main(arguments)
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        _, status = os.waitpid(child, 0)
        texts = []
        for file in (out, error):
            file.seek(0)
            texts.append(file.read().decode(errors="replace"))
    return {
        "arguments": arguments,
        "code": os.waitstatus_to_exitcode(status),
        "out": texts[0],
        "error": texts[1],
        "seconds": time.monotonic() - begun,
    }


if __name__ == "__main__":
    from usdskin import cli

    # What takes long to import, without starting threads.
    import usdskin.inspect  # isort: skip
    import usdskin.render.render  # noqa: F401  # isort: skip

    for line in sys.stdin:
        command = json.loads(line)
        print(
            json.dumps(run(command["arguments"], command["seconds"], command["bytes"])), flush=True
        )
