"""The entry of the command ``fpk``: Ctrl-C is answered from here on, while all else is imported."""

import sys


def main() -> None:
    """Run the command line; Ctrl-C ends it in one line and status 130."""
    try:
        from cases.commands.app import run_app

        run_app()
    except KeyboardInterrupt:
        sys.stderr.write("fpk: stopped; nothing half-written was left\n")
        sys.exit(130)
