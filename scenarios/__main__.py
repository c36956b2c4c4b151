"""Command `teleop`. It stands outside the package `teleop`, so that it can check which project's package that is."""

from __future__ import annotations

import gc
import sys


def main() -> int:
    """Check that the package `teleop` is of this project, then run its command line; returns the exit code."""
    try:
        import channel  # noqa: F401  (its check of `teleop` is the point)
    except ImportError as error:
        print(f"teleop: {error}", file=sys.stderr)
        return 2
    gc.disable()  # until the command begins, for what is imported is no garbage
    try:
        from teleop.__main__ import leave
        from teleop.__main__ import main as command_line

        return leave(command_line())
    finally:
        gc.enable()


if __name__ == "__main__":
    raise SystemExit(main())
