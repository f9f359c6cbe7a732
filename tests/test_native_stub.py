"""The stubs of the compiled extensions against the extensions themselves."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import Any

import pytest

import ccdiff_env
from ccdiff_env import _native

STUB = Path(ccdiff_env.__file__).with_name("_native.pyi")


def public(names) -> set[str]:
    return {name for name in names if not name.startswith("_")}


def stubbed() -> dict[str, Any]:
    """Definitions of the stub by name; typed dictionaries describe values, not names."""
    found: dict[str, Any] = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.ClassDef):
            if not any(
                isinstance(base, ast.Name) and base.id == "TypedDict" for base in node.bases
            ):
                found[node.name] = node
        elif isinstance(node, ast.FunctionDef):
            found[node.name] = node
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[node.target.id] = node
    return found


def parameters(node: ast.FunctionDef) -> list[str]:
    args = node.args
    return [
        a.arg
        for a in (*args.posonlyargs, *args.args, *args.kwonlyargs)
        if a.arg not in ("self", "cls")
    ]


def test_every_public_name_of_the_module_is_in_the_stub_and_none_besides():
    assert set(stubbed()) == public(dir(_native))


@pytest.mark.parametrize(
    "name", [n for n in sorted(public(dir(_native))) if isinstance(getattr(_native, n), type)]
)
def test_every_member_of_a_class_is_in_the_stub_and_none_besides(name):
    native, stub = getattr(_native, name), stubbed()[name]
    members = {n.name: n for n in stub.body if isinstance(n, ast.FunctionDef)}
    assert public(members) == public(dir(native))
    if "__new__" in members:
        assert list(inspect.signature(native).parameters) == parameters(members["__new__"])
    for member in public(members):
        attribute = inspect.getattr_static(native, member)
        is_property = any(
            isinstance(d, ast.Name) and d.id == "property" for d in members[member].decorator_list
        )
        assert is_property == inspect.isgetsetdescriptor(attribute), member
        if not is_property:
            signature = inspect.signature(getattr(native, member))
            assert [p for p in signature.parameters if p != "self"] == parameters(members[member])


@pytest.mark.parametrize(
    "name", [n for n in sorted(public(dir(_native))) if inspect.isroutine(getattr(_native, n))]
)
def test_functions_have_the_parameters_of_the_stub(name):
    node = stubbed()[name]
    assert list(inspect.signature(getattr(_native, name)).parameters) == parameters(node)
