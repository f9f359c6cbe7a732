"""Classes of options and tables of docs/configuration.md, from tables of Rust.

``python -m tools.configuration`` writes the classes, with the extension modules as they are built.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ccdiff_env import _native
from ccdiff_env.models import require_networks

Table = Mapping[str, Any]

ROOT = Path(__file__).resolve().parents[1]
OPTIONS = ROOT / "ccdiff_env" / "traffic" / "options.py"  #: The module that is written.
#: Tables that Python has as dictionaries alone, or as a class written by hand.
PLAIN = (
    "GuidanceConfig", "MapConfig", "ModelConfig", "Normalisation", "SampleOptions", "TrainConfig",
)  # fmt: skip
#: Sizes stored with weights, which the page leaves to the source.
SIZES = ("MapConfig", "ModelConfig", "Normalisation")
#: Annotations of forms without parts.
PLAIN_FORMS = {
    **{"flag": "bool", "count": "int", "number": "float", "text": "str", "any": "Any"},
    "span": "tuple[float, float]",
}
#: Fields that classes of Python have in another form.
OWN_FORM = {"WorldConfig": "named_drivers", "PythonOptions": "model"}
HEAD = '''"""Fields of configurations, written by `python -m tools.configuration`: do not edit.

docs/configuration.md says what the choices mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from ccdiff_env.traffic.checked_options import Options
'''


def tables() -> list[Table]:
    """Return the tables of all configurations."""
    require_networks()
    from ccdiff_env import _models

    return [*json.loads(_native.schema("config_tables")), *json.loads(_models.config_tables())]


def _parts(form: Any, tables: bool) -> Iterator[Any]:
    """Names of the tables in a form, those in choices left out; or choices likewise."""
    if isinstance(form, dict):
        ((kind, inner),) = form.items()
        if kind not in ("table", "one_of", "kinds"):
            yield from _parts(inner, tables)
        elif tables == (kind == "table"):
            yield inner


def _choices(form: Any) -> Iterator[Mapping[str, Any]]:
    return _parts(form, tables=False)


def _tables_in(form: Any) -> Iterator[str]:
    return _parts(form, tables=True)


def _named(table: Table) -> str:
    """Name of the class of a table: that of worlds has more in ``ccdiff_env.config``."""
    return "WorldOptions" if table["name"] == "WorldConfig" else str(table["name"])


def _annotation(form: Any) -> str:
    if isinstance(form, str):
        return PLAIN_FORMS[form]
    ((kind, inner),) = form.items()
    if kind == "one_of":
        return str(inner["name"])
    if kind == "table":
        return "Mapping[str, Any]" if inner in PLAIN else str(inner)
    made = _annotation(inner)
    return {
        "list": f"tuple[{made}, ...]",
        "optional": f"{made} | None",
        "by_name": f"Mapping[str, {made}]",
        "named": f"str | {made}",
    }[kind]


def _alias(choice: Mapping[str, Any]) -> str:
    plain = [v["name"] for v in choice["variants"] if v["form"] is None]
    parts = [f"Literal[{', '.join(json.dumps(name) for name in plain)}]"] if plain else []
    parts += [_annotation(v["form"]) for v in choice["variants"] if v["form"] is not None]
    text = _wrap(_python(choice["doc"]), "#: ", "#: ")
    text += f"\n{choice['name']}: TypeAlias = {' | '.join(parts)}\n"
    if plain:
        return text
    names = ", ".join(f"{v['name']!r}: {_annotation(v['form'])}" for v in choice["variants"])
    return text + f"\n{choice['name'].upper()}: dict[str, type[{choice['name']}]] = {{{names}}}\n"


def _default(field: Mapping[str, Any], value: Any) -> str:
    form = field["form"]
    kind = form if isinstance(form, str) else next(iter(form))
    if kind == "table":
        return f"field(default_factory={form['table']})"
    if kind == "by_name":
        return "field(default_factory=dict, hash=False)"
    if kind == "one_of" and isinstance(value, dict):
        ((name, _),) = value.items()
        chosen = next(v for v in form["one_of"]["variants"] if v["name"] == name)
        return f"field(default_factory={chosen['form']['table']})"
    return repr(tuple(value)) if isinstance(value, list) else repr(value)


def _text(doc: str) -> list[str]:
    """Paragraphs of a comment, each on one line."""
    lines = "\n".join(line.strip() for line in doc.splitlines())
    return [" ".join(part.split()) for part in lines.strip().split("\n\n")]


def _python(doc: str) -> str:
    return re.sub(r"`([^`]+)`", r"``\1``", " ".join(_text(doc)))


def _describe(field: Mapping[str, Any]) -> str:
    """Meaning of a field with its unit and range in its first clause."""
    text, facts = " ".join(_text(field["doc"])), [field["unit"], field["range"]]
    known = ", ".join(fact for fact in facts if fact)
    clause = re.match(r"(.*?)(;|\.(?= |$))", text)
    if not known or clause is None:
        return text
    return f"{clause[1]} ({known}){text[clause.end(1) :]}"


def _wrap(text: str, first: str, then: str) -> str:
    wrapper = textwrap.TextWrapper(
        100, initial_indent=first, subsequent_indent=then, break_on_hyphens=False
    )
    return wrapper.fill(text)  # links stay whole


def _with_comment(line: str, text: str) -> list[str]:
    """Return a line of code with its comment behind it, or above where there is no room."""
    both = f"{line}  #: {text}"
    return [both] if len(both) <= 100 else [_wrap(text, "    #: ", "    #: "), line]


def _class(table: Table) -> str:
    first, *more = (_python(part) for part in _text(table["doc"]))
    summary, _, rest = first.partition(". ")
    paragraphs = [f'"""{summary.rstrip(".")}."""', *(p for p in (rest, *more) if p)]
    lines = ["@dataclass(frozen=True, kw_only=True)", f"class {_named(table)}(Options):"]
    text = "\n\n".join(_wrap(p, "    ", "    ") for p in paragraphs)
    lines += [text if "\n" not in text else text.replace('."""', ".", 1) + '\n    """', ""]
    for entry in table["fields"]:
        if OWN_FORM.get(table["name"]) == entry["name"]:
            continue
        doc = re.sub(r"`([^`]+)`", r"``\1``", _describe(entry))
        line = f"    {entry['name']}: {_annotation(entry['form'])}"
        if table["defaults"] is not None:
            line += f" = {_default(entry, table['defaults'][entry['name']])}"
        lines += _with_comment(line, doc)
    return "\n".join(lines) + "\n"


def classes(found: list[Table]) -> str:
    """Return the module of classes."""
    kept = [t for t in found if not (t["name"] in PLAIN or _below_plain(t, found))]
    parts, done = [HEAD.rstrip()], set[str]()

    def add_choice(choice: Mapping[str, Any]) -> None:
        if choice["name"] not in done:
            done.add(choice["name"])
            for variant in choice["variants"]:
                add_form(variant["form"])
            parts.append(_alias(choice).rstrip())  # one empty line between them is enough

    def add_form(form: Any) -> None:
        for choice in _choices(form):
            add_choice(choice)
        for name in _tables_in(form):
            add(next((t for t in kept if t["name"] == name), None))

    def add(table: Table | None) -> None:
        if table is None or table["name"] in done:
            return
        done.add(table["name"])
        for entry in table["fields"]:
            add_form(entry["form"])
        parts.append(_class(table))

    for table in kept:
        add(table)
    return _format("\n\n".join(parts))


def _format(text: str) -> str:
    return subprocess.run(
        [sys.executable, "-m", "ruff", "format", "-q", "--stdin-filename", "options.py", "-"],
        input=text,
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout


def _below_plain(table: Table, found: list[Table]) -> bool:
    """Whether a table is only reached through one that is a dictionary in Python."""
    plain = [t for t in found if t["name"] in PLAIN]
    inside = (c for t in plain for e in t["fields"] for c in _choices(e["form"]))
    return any(table["name"] in _tables_in(v["form"]) for c in inside for v in c["variants"])


def _shown(entry: Mapping[str, Any], table: Table) -> str:
    """Default of a field in the page."""
    if table["defaults"] is None:
        return "required"
    names = list(_tables_in(entry["form"]))
    if names and entry["form"] in ({"table": names[0]}, {"optional": {"table": names[0]}}):
        return f"[{names[0]}](#{names[0].lower()})"
    value = table["defaults"][entry["name"]]
    if isinstance(value, dict) and len(value) == 1:
        value = next(iter(value))
    if isinstance(value, list) and value and isinstance(value[0], dict):
        value = [{"kind": term["kind"]} for term in value]
    return f"`{json.dumps(value) if value is not None else None}`"


def page(found: list[Table]) -> str:
    """Return what the page says of the fields."""
    lines: list[str] = []
    seen = set[str]()
    for table in found:
        plain = table["name"] in PLAIN or _below_plain(table, found)
        if not plain or table["name"] in SIZES:
            continue
        lines += ["", f"## {table['name']}", "", "\n\n".join(_text(table["doc"])), ""]
        for entry in table["fields"]:
            lines.append(f"* `{entry['name']}` ({_shown(entry, table)}): {_describe(entry)}")
        for entry in table["fields"]:
            for choice in _choices(entry["form"]):
                if choice["name"] in seen:
                    continue
                seen.add(choice["name"])
                lines += ["", f"`{entry['name']}`:", ""]
                for v in choice["variants"]:
                    links = "".join(f" ([{n}](#{n.lower()}))" for n in _tables_in(v["form"]))
                    lines.append(f"* `{v['name']}`{links}: {' '.join(_text(v['doc']))}")
    return "\n".join(lines).strip()


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    OPTIONS.write_text(classes(tables()), encoding="utf-8")
