"""`python -m glhybrid`, the same as the command `glhybrid`."""

from glhybrid.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
