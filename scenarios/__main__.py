"""The `teleop` command. It lives outside `teleop`, so that it can tell whose `teleop` it has found."""

from __future__ import annotations

import sys


def main() -> int:
    """Check whose `teleop` is installed, then hand over to its command line; returns the exit code."""
    try:
        import channel  # noqa: F401  (its check of `teleop` is the point)
    except ImportError as error:
        print(f"teleop: {error}", file=sys.stderr)
        return 2
    from teleop.__main__ import main as command_line

    return command_line()


if __name__ == "__main__":
    raise SystemExit(main())
