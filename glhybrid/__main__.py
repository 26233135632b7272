"""The command `glhybrid`, and `python -m glhybrid`."""

import os
import sys


def main() -> int:
    """Runs the command line; returns the exit code. Ctrl-C is heard while modules are still being imported, too."""
    try:
        open_streams()
        from glhybrid import cli
    except KeyboardInterrupt:
        return 130
    return cli.main()


def open_streams() -> None:
    """Standard streams that whoever started us closed lead nowhere, so that no file opened later takes their number."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is not None:
            continue
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
        setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115


if __name__ == "__main__":
    raise SystemExit(main())
