"""The command `glhybrid`, and `python -m glhybrid`."""


def main() -> int:
    """Runs the command line; returns the exit code. Ctrl-C is heard while modules are still being imported, too."""
    try:
        from glhybrid import cli
    except KeyboardInterrupt:
        return 130
    return cli.main()


if __name__ == "__main__":
    raise SystemExit(main())
