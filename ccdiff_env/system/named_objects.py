"""Custom classes and functions by name: ``module:name``, ``module:Class?option=value``."""

from __future__ import annotations

import functools
import importlib
import inspect
import json
import os
import sys
from typing import Any
from urllib.parse import unquote

from ccdiff_env.errors import ConfigError


def named_object(text: str, what: str) -> Any:
    """Import ``module:name``; modules of the working folder are found, too.

    Options follow as ``?name=value&name=value``: numbers, ``true``, ``false``, ``null`` and quoted
    texts of JSON; everything else is a text itself, and ``title`` is for tables alone. With
    options, the result is a class whose options are given, or a function likewise. A
    :class:`ConfigError` names a module, object or option that is not there; ``what`` says in it
    what the object is.
    """
    text = strip_title(text)
    path, _, options = text.partition("?")
    module, _, name = path.partition(":")
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise
        raise ConfigError(
            f"{what} {text!r}: no module {error.name!r} in {os.getcwd()}, nor installed"
        ) from None
    except (AttributeError, ValueError):
        raise ConfigError(f"{what} {text!r}: no {name!r} in module {module!r}") from None
    return (
        _with_options(found, option_values(options, what, text), what, text) if options else found
    )


def title_of(text: str) -> str | None:
    """Return what a text asks to be called in tables and on pages, ``?title=Ours``, if it does."""
    parts = text.partition("?")[2].split("&")
    return next((unquote(p.removeprefix("title=")) for p in parts if p.startswith("title=")), None)


def strip_title(text: str) -> str:
    """Return a text without its title; an empty title is a :class:`ConfigError`."""
    if title_of(text) == "":
        raise ConfigError(f"{text!r}: the title is empty")
    path, _, options = text.partition("?")
    kept = "&".join(part for part in options.split("&") if not part.startswith("title="))
    return f"{path}?{kept}" if kept else path


def object_name(found: Any, what: str) -> str:
    """Return the ``module:name`` by which an object is imported.

    One that has none, such as a lambda or a function within another, is a :class:`ConfigError`.
    """
    text = f"{getattr(found, '__module__', '')}:{getattr(found, '__qualname__', '')}"
    if "<" in text or named_object(text, what) is not found:
        raise ConfigError(f"{what} {text}: expected what can be imported, as module:name")
    return text


def named_instance(text: str, what: str) -> Any:
    """Import what a text names; of a class make an object, without other arguments: one that needs
    options which are not given is a :class:`ConfigError`.
    """
    found = named_object(text, what)
    if not isinstance(found, type):
        return found
    try:
        inspect.signature(found).bind()
    except TypeError as error:
        takes = ", ".join(_options_of(found)) or "none"
        raise ConfigError(f"{what} {text!r}: {error}; it takes {takes}, as ?option=value") from None
    return found()


def _options_of(found: Any) -> list[str]:
    """Names of the arguments that may be given by name."""
    given = inspect.signature(found).parameters.values()
    return [p.name for p in given if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]


def option_values(options: str, what: str, text: str) -> dict[str, Any]:
    """Return the values of ``name=value&name=value`` by name, as in :func:`named_object`.

    Names of parts, ``part.name``, are names, too. Another form is a :class:`ConfigError`.
    """
    found: dict[str, Any] = {}
    for part in options.split("&"):
        name, equals, value = part.partition("=")
        if not equals or not all(map(str.isidentifier, name.split("."))) or name in found:
            raise ConfigError(f"{what} {text!r}: {part!r}, expected option=value, each option once")
        found[name] = _value(value)
    return found


def _value(text: str) -> Any:
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return text if isinstance(value, (list, dict)) else value


def _with_options(found: Any, options: dict[str, Any], what: str, text: str) -> Any:
    """Return a class or function with options; it is called by its name and the options."""
    if not callable(found) or not (isinstance(found, type) or inspect.isroutine(found)):
        raise ConfigError(f"{what} {text!r}: a {type(found).__name__} takes no options")
    named, given = _options_of(found), inspect.signature(found).parameters.values()
    unknown = [name for name in options if name not in named]
    if unknown and not any(p.kind is p.VAR_KEYWORD for p in given):
        takes = ", ".join(named) or "none"
        raise ConfigError(f"{what} {text!r}: no option {unknown[0]!r}, it takes {takes}")
    made: Any
    if isinstance(found, type):
        init = functools.partialmethod(found.__init__, **options)  # type: ignore[misc]
        made = type(found.__name__, (found,), {"__init__": init})
    else:
        made = functools.partial(found, **options)
    # configurations and reports name a model by these
    made.__module__ = found.__module__
    made.__qualname__ = f"{found.__qualname__}?{text.partition('?')[2]}"
    return made
