"""Makes the files of this folder: ``python tests/attacks/make.py``; README.md says what they do."""

from __future__ import annotations

import pickle
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
STEPS = 11


@dataclass(frozen=True)
class Name:
    """A global."""

    module: str
    name: str


@dataclass(frozen=True)
class Call:
    """What a global returns, with a state."""

    function: Name
    arguments: tuple[Any, ...] = ()
    state: Any = None


@dataclass(frozen=True)
class Steps:
    """Steps of the pickle machine as they are."""

    code: bytes


def assembled(value: Any) -> bytes:
    """Return steps that put a value on the stack; Python's own pickler would refuse most."""
    if isinstance(value, Steps):
        return value.code
    if isinstance(value, Name):
        return pickle.GLOBAL + f"{value.module}\n{value.name}\n".encode()
    if isinstance(value, Call):
        code = assembled(value.function) + assembled(value.arguments) + pickle.REDUCE
        return code if value.state is None else code + assembled(value.state) + pickle.BUILD
    if isinstance(value, bool) or value is None:
        return {True: pickle.NEWTRUE, False: pickle.NEWFALSE, None: pickle.NONE}[value]
    if isinstance(value, int):
        size = value.bit_length() // 8 + 1
        return pickle.LONG1 + bytes([size]) + value.to_bytes(size, "little", signed=True)
    if isinstance(value, float):
        return pickle.BINFLOAT + struct.pack(">d", value)
    if isinstance(value, str):
        return pickle.BINUNICODE + struct.pack("<I", len(value.encode())) + value.encode()
    if isinstance(value, bytes):
        return pickle.BINBYTES + struct.pack("<I", len(value)) + value
    if isinstance(value, dict):
        items = b"".join(assembled(k) + assembled(v) for k, v in value.items())
        return pickle.MARK + items + pickle.DICT
    items = b"".join(map(assembled, value))
    return pickle.MARK + items + (pickle.TUPLE if isinstance(value, tuple) else pickle.LIST)


NDARRAY = Name("numpy", "ndarray")
DTYPE = Name("numpy", "dtype")
RECONSTRUCT = Name("numpy.core.multiarray", "_reconstruct")
SCALAR = Name("numpy.core.multiarray", "scalar")
FROMBUFFER = Name("numpy.core.numeric", "_frombuffer")
ENCODE = Name("_codecs", "encode")
F8 = Call(DTYPE, ("f8", False, True), (3, "<", None, None, None, -1, -1, 0))


CODE = ("f8", False, True)
FIELDS = (3, "<", None, ("a",), {"a": (F8, 1 << 20)}, 8, 8, 0)


def array(data: Any, shape: tuple[int, ...], dtype: Any = F8) -> Call:
    return Call(RECONSTRUCT, (NDARRAY, (0,), b"b"), (1, shape, dtype, False, data))


def forged_dtype(fields: dict[str, Any], size: int = 8) -> Call:
    """A dtype with fields that its code does not have."""
    return Call(DTYPE, (f"V{size}", False, True), (3, "|", None, tuple(fields), fields, size, 1, 0))


def nested(core: Any, opening: bytes = pickle.MARK, closing: bytes = pickle.LIST) -> Steps:
    """Thirty levels of ``[x, x]`` around a value, each made once."""
    code = assembled(core)
    for level in range(30):
        put, get = (op + bytes([level]) for op in (pickle.BINPUT, pickle.BINGET))
        code += put + pickle.POP + opening + get + get + closing
    return Steps(code)


def track(**state: Any) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "position": [[float(i), 0.0, 0.0] for i in range(STEPS)],
        "heading": [0.0] * STEPS,
        "velocity": [[10.0, 0.0]] * STEPS,
        "valid": [1.0] * STEPS,
        "length": [4.5] * STEPS,
        "width": [1.9] * STEPS,
    }
    return {"type": "VEHICLE", "state": numbers | state, "metadata": {"type": "VEHICLE"}}


def lane(polyline: Any, **more: Any) -> dict[str, Any]:
    return {"type": "LANE_SURFACE_STREET", "polyline": polyline, **more}


def scenario(
    metadata: dict[Any, Any] | None = None,
    *,
    tracks: dict[Any, Any] | None = None,
    features: dict[Any, Any] | None = None,
) -> bytes:
    ego = {"ego": track()}
    return (
        pickle.PROTO
        + b"\4"
        + assembled(
            {
                "id": "attack",
                "length": STEPS,
                "metadata": {"sdc_id": "ego", "sample_rate": 0.1, **(metadata or {})},
                "tracks": {**ego, **(tracks or {})},
                "map_features": features or {},
            }
        )
        + pickle.STOP
    )


def heading(data: Any) -> bytes:
    return scenario(tracks={"ego": track(heading=data)})


def pickles() -> dict[str, bytes]:
    """Scenario descriptions."""
    forged = forged_dtype({"a": (Call(DTYPE, ("O8", False, True)), 0)})
    words = b"A" * 8 * STEPS
    loud = Call(Name("os", "system"), ("echo ccdiff-env was attacked",))
    return {
        # objects forged from bytes
        "dtype_fields_frombuffer": heading(Call(FROMBUFFER, (words, forged, (STEPS,), "C"))),
        "dtype_fields_array": heading(array(words, (STEPS,), forged)),
        "dtype_fields_scalar": scenario({"x": Call(SCALAR, (forged, b"A" * 8))}),
        "dtype_field_beyond_the_end": heading(
            array(words, (STEPS,), forged_dtype({"a": (F8, 1 << 20)}))
        ),
        "dtype_subarray": heading(
            array(
                words,
                (STEPS,),
                Call(
                    DTYPE,
                    ("V8", False, True),
                    (3, "|", (F8, (1 << 20,)), None, None, 8, 1, 0),
                ),
            )
        ),
        "dtype_state_of_a_number": heading(array(words, (STEPS,), Call(DTYPE, CODE, FIELDS))),
        "dtype_object": heading(array([1.0] * STEPS, (STEPS,), Call(DTYPE, ("O8", False, True)))),
        "array_larger_than_its_bytes": heading(array(b"A" * 8, (1 << 40,))),
        "array_of_negative_shape": heading(array(b"", (-1, 0))),
        "array_from_a_list": heading(array([0.0] * STEPS, (STEPS,))),
        "frombuffer_of_an_array": heading(
            Call(FROMBUFFER, (array(words, (STEPS,)), F8, (STEPS,), "C"))
        ),
        # code
        "call_os_system": scenario({"x": loud}),
        "call_of_a_string": scenario({"x": Call("str", ())}),  # type: ignore[arg-type]
        "class_of_numpy": scenario({"x": Name("numpy", "memmap")}),
        "global_by_way_of_a_module": scenario({"x": Name("numpy.core.multiarray", "os.system")}),
        "state_of_a_global": scenario(
            {"x": Call(FROMBUFFER, (b"", F8, (0,), "C"), (None, {"__defaults__": (loud,)}))}
        ),
        "attributes_of_a_global": scenario(
            {"x": Steps(assembled(FROMBUFFER) + assembled((None, {"make": 1})) + pickle.BUILD)}
        ),
        "new_object": scenario(
            {"x": Steps(assembled(NDARRAY) + assembled(((1 << 40,),)) + pickle.NEWOBJ)}
        ),
        "object": scenario({"x": Steps(pickle.MARK + assembled(DTYPE) + pickle.OBJ)}),
        "persistent_id": scenario({"x": Steps(pickle.PERSID + b"x\n")}),
        "extension": scenario({"x": Steps(pickle.EXT1 + b"\1")}),
        # time and memory
        "shared_lists_scenario_id": scenario({"scenario_id": nested(["lol"])}),
        "shared_lists_dataset": scenario({"dataset": nested(["lol"])}),
        "shared_lists_sample_rate": scenario({"sample_rate": nested(["lol"])}),
        "shared_lists_time_stamps": scenario({"ts": nested([0.0])}),
        "shared_lists_sdc_id": scenario({"sdc_id": nested(["lol"])}),
        "shared_lists_map": scenario({"map": nested(["lol"])}),
        "shared_lists_origin": scenario({"ccdiff_env": {"origin": nested([0.0])}}),
        "shared_lists_type": scenario(tracks={"a": track() | {"type": nested(["lol"])}}),
        "shared_lists_category": scenario(
            tracks={"a": track() | {"metadata": {"type": nested(["lol"])}}}
        ),
        "shared_lists_exit_lanes": scenario(
            features={"1": lane([[0.0, 0.0], [9.0, 0.0]], exit_lanes=nested(["lol"]))}
        ),
        "shared_lists_polyline": scenario(features={"1": lane(nested([0.0]))}),
        "shared_lists_heading": heading(nested([0.0])),
        "shared_tuples_as_a_key": scenario(
            {Steps(nested("lol", closing=pickle.TUPLE).code): 1}  # the hash has no end
        ),
        "shared_tuples_in_a_set": scenario(
            {"x": Call(Name("builtins", "set"), ([nested("lol", closing=pickle.TUPLE)],))}
        ),
        "punycode": scenario({"x": Call(ENCODE, ("ü" * 20_000, "punycode"))}),
        "memo_of_64_gib": scenario(
            {"x": Steps(assembled(1) + pickle.LONG_BINPUT + b"\xff\xff\xff\xff")}
        ),
        "bytearray_of_an_exbibyte": scenario(
            {"x": Steps(pickle.BYTEARRAY8 + struct.pack("<Q", 1 << 60))}
        ),
        "nested_50000_deep": scenario(
            {"x": Steps(pickle.EMPTY_LIST * 50_000 + pickle.APPEND * 49_999)}
        ),
        "one_line_in_2000_lanes": scenario(
            features={
                "0": lane(
                    Steps(
                        assembled([[float(i % 2) * 1e4, 0.0] for i in range(1000)])
                        + pickle.BINPUT
                        + b"\0"
                    )
                ),
                **{str(i): lane(Steps(pickle.BINGET + b"\0")) for i in range(1, 2000)},
            }
        ),
        "line_of_3e7_m": scenario(features={"1": lane([[0.0, 0.0], [3e7, 0.0]])}),
        "line_of_1e12_m": scenario(features={"1": lane([[0.0, 0.0], [1e12, 0.0]])}),
        "line_of_1e300_m": scenario(features={"1": lane([[0.0, 0.0], [1e300, 0.0]])}),
        # fields of the wrong kind
        "number_without_end": heading([0.0] * (STEPS - 1) + [10**400]),
        "metadata_of_a_track_is_a_list": scenario(tracks={"a": track() | {"metadata": [1]}}),
        "exit_lanes_are_a_number": scenario(
            features={"1": lane([[0.0, 0.0], [9.0, 0.0]], exit_lanes=7)}
        ),
        "polyline_is_a_number": scenario(features={"1": lane(7)}),
        "time_stamps_are_text": scenario({"ts": "now"}),
    }


def texts() -> dict[str, bytes]:
    """JSON of certificates, manifests, configurations and run folders."""
    return {"nested_100000_deep.json": b"[" * 100_000, "a_list.json": b"[]", "empty.json": b""}


def files() -> dict[str, bytes]:
    """Return every file of this folder."""
    made = {f"{name}.pkl": data for name, data in pickles().items()}
    return made | texts()


if __name__ == "__main__":
    for old in (*FOLDER.glob("*.pkl"), *FOLDER.glob("*.json")):
        old.unlink()
    for name, data in files().items():
        (FOLDER / name).write_bytes(data)
