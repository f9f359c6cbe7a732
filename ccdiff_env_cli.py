"""The command line: ``ccdiff-env <verb>``.

It stands outside of the package, whose import takes the time of NumPy and Gymnasium, and imports
what a verb needs when that verb is called: help comes at once.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import signal
import sys
import sysconfig
import threading
import traceback
import warnings
from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

#: What each verb does, and the module of the package with its `add_arguments` and `run`.
VERBS = {
    "train": ("train a planning network (resumes a run in --out)", "training.train_command"),
    "train-ego": ("train an ego with PPO (resumes a run in --out)", "training.train_ego"),
    "distil": ("distil guided CCDiff into swift traffic", "training.distil"),
    "bench": ("benchmarks of traffic and of planners", "bench.cli"),
    "view": ("write a replay page, an image or a video", "bench.view_command"),
    "scenes": ("list the scenes of a source", "view.listing"),
    "play": ("write a page in which you drive the ego with the keyboard", "view.play"),
    "doctor": ("check the installation and say what is missing", "bench.doctor"),
}


class _Help(argparse.HelpFormatter):
    """Help that shows defaults, where there are any to show."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        default = action.default
        silent = any(default is none for none in (None, False, argparse.SUPPRESS)) or default == []
        if silent or not action.option_strings:
            return action.help
        text = " ".join(map(str, default)) if isinstance(default, list) else str(default)
        return f"{action.help or ''} (default: {text.replace('%', '%%')})"


def _meant(word: str, known: Iterable[str]) -> str:
    """What somebody may have meant who typed a word that is none of those known."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


class _Parser(argparse.ArgumentParser):
    """A parser that says what may have been meant; verbs answer for their own options."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": _Help, **options})

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; refuse what is unknown here, where the usage is that of the verb."""
        found, unknown = super().parse_known_args(args, namespace)
        for word in unknown:
            name = word.partition("=")[0]
            what = "option" if name.startswith("-") else "argument"
            self.error(f"there is no {what} {name}{_meant(name, self._option_string_actions)}")
        return found, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        raise argparse.ArgumentError(
            action, f"{value!r} is none of {', '.join(known)}{_meant(str(value), known)}"
        )

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and where the options are; the usage of most verbs fills a screen."""
        self.exit(2, f"{self.prog}: {message}\n{self.prog} --help lists the options\n")


class _Version(argparse.Action):
    """Prints the version; the package is imported for it alone."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from ccdiff_env.system.version import __version__

        print(f"ccdiff-env {__version__}")
        parser.exit()


def parser_for(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of a command line; of its verb alone it has the arguments."""
    parser = _Parser(prog="ccdiff-env", description="A driving environment with learned traffic.")
    parser.add_argument("--version", nargs=0, action=_Version, help="print the version")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    for verb, (help_text, module) in VERBS.items():
        arguments = verbs.add_parser(verb, help=help_text, description=help_text)
        if list(words[:1]) == [verb]:
            found = import_module(f"ccdiff_env.{module}")
            arguments.set_defaults(run=getattr(found, "run", None))
            found.add_arguments(arguments)
    return parser


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Read a command line; ends the process as argparse does, where it is wrong."""
    return parser_for(words).parse_args(words)


def _interrupt(number: int, _: object) -> NoReturn:
    """End as Ctrl-C does: SIGTERM is what schedulers and containers send, before they kill."""
    raise KeyboardInterrupt(number)


def own_traceback(error: BaseException) -> str:
    """Return the traceback of an error that code of the user's own raised, or led to; else "".

    Errors of other processes have theirs in their cause.
    """
    text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    here = Path(__file__)
    known = {here, here.parent / "ccdiff_env", *map(Path, sysconfig.get_paths().values())}
    files = map(Path, re.findall(r'^ *File "([^"<]+)"', text, re.MULTILINE))
    failed = type(error).__name__ == "PolicyError" and error.__cause__ is not None
    return text if failed or any(not {file, *file.parents} & known for file in files) else ""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb; return the exit status."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as a daemon's are
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")  # on a terminal of ASCII
    args = parse(sys.argv[1:] if argv is None else argv)
    from ccdiff_env.errors import CcdiffError

    usual = warnings.formatwarning
    if in_main := threading.current_thread() is threading.main_thread():
        ended = signal.signal(signal.SIGTERM, _interrupt)
    warnings.formatwarning = lambda text, *_, **__: f"ccdiff-env {args.verb}: {text}\n"
    try:
        status: int = args.run(args)
        sys.stdout.flush()
    except BrokenPipeError:  # who read the output, as head does, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (CcdiffError, OSError) as error:
        print(f"ccdiff-env {args.verb}: {error}", file=sys.stderr)
        print(own_traceback(error), end="", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print("interrupted", file=sys.stderr)
        return 128 + int(*interrupt.args or (signal.SIGINT,))
    finally:
        warnings.formatwarning = usual
        if in_main:
            signal.signal(signal.SIGTERM, ended)
    return status


if __name__ == "__main__":
    sys.exit(main())
