"""The command ``ldc``: a file each for most subcommands. Nothing heavy is imported before a subcommand runs."""

import argparse
import contextlib
import json
import logging
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

import ldctoolkit.compiling as compiling
from ldctoolkit.declared import UnitWarning
from ldctoolkit.deprecation import LdcDeprecationWarning
from ldctoolkit.errors import LdcError, closest
from ldctoolkit.surroundings import sweep
from ldctoolkit.version import __version__

from . import assess, controllers, doctor, export, extract, fit, identify, init, rank, report, review, risk, run
from ._console import moving_line


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line, as for any other wrong input."""
        self.exit(2, f"ldc: error: {message} (see {self.prog} --help)\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """What is left over is an error of the command that it follows, with its nearest option."""
        namespace, rest = super().parse_known_args(args, namespace)
        if rest:
            options = [name for name, action in self._option_string_actions.items() if action.help != argparse.SUPPRESS]
            close = closest(rest[0].partition("=")[0], options)
            self.error(f"unrecognized argument {rest[0]!r}{f': did you mean {close}?' if close else ''}")
        return namespace, rest


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    top = _Parser(
        prog="ldc",
        description="Compare lane departure correction designs on realistic, generated lane departures.",
        epilog="Driving recordings -> ldc extract -> ldc fit -> ldc run -> ranking and report.",
    )
    top.add_argument("--version", action="store_true", help="show the version and exit")
    about = "with --version: versions of packages, machine and threads, which a ranking depends on"
    top.add_argument("--json", action="store_true", dest="json_version", help=about)
    commands = top.add_subparsers(title="commands", metavar="COMMAND")
    for command in (extract, fit, identify, review, assess, init, run, rank, risk, report, export, controllers, doctor):
        command.add_parser(commands)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command."""
    sweep()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError):  # a stream that is no file
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        with _warnings_on_stderr(), compiling.shown_by(moving_line):
            args = (top := parser()).parse_args(arguments)
            if args.version:
                print(json.dumps(doctor.environment(), indent=1) if args.json_version else f"ldc {__version__}")
            elif "run" not in args or args.json_version:
                top.error(f"the following arguments are required: {'--version' if args.json_version else 'COMMAND'}")
            code: int = 0 if args.version else args.run(args) or 0
        sys.stdout.flush()
    except (LdcError, MemoryError) as error:
        print(f"ldc: error: {error or 'not enough memory'}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("ldc: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # the reader (head, less) has gone; Python would complain once more while closing stdout
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:  # of stdout, or of the folder for temporary files: a full disk
        print(f"ldc: error: {error.filename or 'the output'}: {error.strerror or error}", file=sys.stderr)
        return 2
    return code


@contextlib.contextmanager
def _warnings_on_stderr() -> Iterator[None]:
    """What the studies log, one line each, instead of what the process does with it otherwise."""
    log, handler = logging.getLogger("studies"), logging.StreamHandler(sys.stderr)
    before = log.handlers[:], log.propagate
    handler.setFormatter(logging.Formatter("ldc: warning: %(message)s"))
    log.handlers[:], log.propagate = [handler], False
    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *location: Any, **other: Any) -> None:
        if not issubclass(category, (UnitWarning, LdcDeprecationWarning)):
            usual(message, category, *location, **other)
        elif str(message) not in shown:
            shown.add(str(message))
            print(f"ldc: warning: {message}", file=sys.stderr)

    try:
        with warnings.catch_warnings():
            usual, warnings.showwarning = warnings.showwarning, show
            for kind in (UnitWarning, LdcDeprecationWarning):
                warnings.simplefilter("always", kind)
            yield
    finally:
        log.handlers[:], log.propagate = before
