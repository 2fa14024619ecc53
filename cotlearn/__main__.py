"""The command `cotlearn`, also as `python -m cotlearn`."""

import sys

from cotlearn.interrupt import end_at_once


def main() -> None:
    """Runs the command; Ctrl-C ends it without a traceback, even while it loads."""
    # With this package, which it does not need, jsonschema (of nbformat) takes 1.6 s to load.
    sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
    end_at_once()
    try:
        from cotlearn.cli import main as command

        command()
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
