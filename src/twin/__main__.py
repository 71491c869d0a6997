"""The program ``ballplate``: Ctrl-C ends it in one line, whatever it is at."""

import os
import signal


def main() -> None:
    """Run the command line: while it is imported Ctrl-C ends it at once, then in order."""
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not so below nohup
    if heeded:
        signal.signal(signal.SIGINT, _end)
    from twin.cli import main as command_line  # noqa: PLC0415  it takes a while

    try:
        if heeded:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        command_line()
    except KeyboardInterrupt:
        _end()
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it has ended


def _end(*_: object) -> None:
    os.write(2, b"ballplate: interrupted\n")
    os._exit(1)


if __name__ == "__main__":
    main()
