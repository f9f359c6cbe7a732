"""Scenario descriptions that were made to harm, as steps of the pickle machine."""

import pickle
import struct
from dataclasses import dataclass
from typing import Any

STEPS = 11


@dataclass(frozen=True)
class Name:
    """A global."""

    module: str
    name: str


@dataclass(frozen=True)
class Call:
    """What a global returns, with a state."""

    function: Any
    arguments: tuple[Any, ...] = ()
    state: Any = None


@dataclass(frozen=True)
class Steps:
    """Steps of the machine as they are."""

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
    if isinstance(value, dict):
        items = b"".join(assembled(k) + assembled(v) for k, v in value.items())
        return pickle.MARK + items + pickle.DICT
    if isinstance(value, (tuple, list)):
        items = b"".join(map(assembled, value))
        return pickle.MARK + items + (pickle.TUPLE if isinstance(value, tuple) else pickle.LIST)
    code = pickle.dumps(value, 3)[2:-1]  # without head and end
    return code.removesuffix(b"q\0") if isinstance(value, (str, bytes)) else code


NDARRAY = Name("numpy", "ndarray")
DTYPE = Name("numpy", "dtype")
RECONSTRUCT = Name("numpy.core.multiarray", "_reconstruct")
SCALAR = Name("numpy.core.multiarray", "scalar")
FROMBUFFER = Name("numpy.core.numeric", "_frombuffer")
CODE = ("f8", False, True)
F8 = Call(DTYPE, CODE, (3, "<", None, None, None, -1, -1, 0))
OBJECT = Call(DTYPE, ("O8", False, True))
WORDS = b"A" * 8 * STEPS


def array(data: Any, shape: tuple[int, ...] = (STEPS,), dtype: Any = F8) -> Call:
    return Call(RECONSTRUCT, (NDARRAY, (0,), b"b"), (1, shape, dtype, False, data))


def forged(fields: dict[str, Any]) -> Call:
    """A dtype with fields that its code does not have."""
    return Call(DTYPE, ("V8", False, True), (3, "|", None, tuple(fields), fields, 8, 1, 0))


def nested(core: Any, closing: bytes = pickle.LIST) -> Steps:
    """Thirty levels of ``[x, x]`` around a value, each made once."""
    code = assembled(core)
    for level in range(30):
        put, get = (op + bytes([level]) for op in (pickle.BINPUT, pickle.BINGET))
        code += put + pickle.POP + pickle.MARK + get + get + closing
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


def scenario(metadata: Any = None, tracks: Any = None, features: Any = None) -> bytes:
    fields = {
        "id": "attack",
        "length": STEPS,
        "metadata": {"sdc_id": "ego", "sample_rate": 0.1, **(metadata or {})},
        "tracks": {"ego": track(), **(tracks or {})},
        "map_features": features or {},
    }
    return pickle.PROTO + b"\4" + assembled(fields) + pickle.STOP


def heading(data: Any) -> bytes:
    return scenario(tracks={"ego": track(heading=data)})


def extra(value: Any) -> bytes:
    return scenario({"x": value})


def lane(polyline: Any, **more: Any) -> bytes:
    line = {"type": "LANE_SURFACE_STREET", "polyline": polyline, **more}
    return scenario(features={"1": line})


def pickles() -> dict[str, bytes]:
    """Return the descriptions by what they try."""
    beyond = {"a": (F8, 1 << 20)}
    subarray = (3, "|", (F8, (1 << 20,)), None, None, 8, 1, 0)
    loud = Call(Name("os", "system"), ("echo ccdiff-env was attacked",))
    line = [[0.0, 0.0], [9.0, 0.0]]
    zigzag = Steps(assembled([[float(i % 2) * 1e4, 0.0] for i in range(1000)]) + b"q\0")
    street = {"type": "LANE_SURFACE_STREET"}
    lists, tuples = nested(["lol"]), nested("lol", pickle.TUPLE)
    numbers = b"".join(
        b"\x8a\x0a" + (i * (2**61 - 1)).to_bytes(10, "little", signed=True) + b"N"
        for i in range(1, 40_000)
    )
    return {
        # memory is read where the bytes point, or behind the buffer
        "dtype_fields_frombuffer": heading(
            Call(FROMBUFFER, (WORDS, forged({"a": (OBJECT, 0)}), (STEPS,), "C"))
        ),
        "dtype_fields_array": heading(array(WORDS, dtype=forged({"a": (OBJECT, 0)}))),
        "dtype_fields_scalar": extra(Call(SCALAR, (forged({"a": (OBJECT, 0)}), b"A" * 8))),
        "dtype_field_beyond_the_end": heading(array(WORDS, dtype=forged(beyond))),
        "dtype_subarray": heading(array(WORDS, dtype=Call(DTYPE, ("V8", False, True), subarray))),
        "dtype_state_of_a_number": heading(
            array(WORDS, dtype=Call(DTYPE, CODE, (3, "<", None, ("a",), beyond, 8, 8, 0)))
        ),
        "dtype_object": heading(array([1.0] * STEPS, dtype=OBJECT)),
        "array_larger_than_its_bytes": heading(array(b"A" * 8, (1 << 40,))),
        "array_of_negative_shape": heading(array(b"", (-1, 0))),
        "array_from_a_list": heading(array([0.0] * STEPS)),
        "frombuffer_of_an_array": heading(Call(FROMBUFFER, (array(WORDS), F8, (STEPS,), "C"))),
        # code
        "call_os_system": extra(loud),
        "call_of_a_string": extra(Call("str")),
        "class_of_numpy": extra(Name("numpy", "memmap")),
        "global_by_way_of_a_module": extra(Name("numpy.core.multiarray", "os.system")),
        "state_of_a_global": extra(
            Call(FROMBUFFER, (b"", F8, (0,), "C"), (None, {"__defaults__": (loud,)}))
        ),
        "attributes_of_a_global": extra(
            Steps(assembled(FROMBUFFER) + assembled((None, {"_make": 1})) + pickle.BUILD)
        ),
        "new_object": extra(Steps(assembled(NDARRAY) + assembled(((1 << 40,),)) + pickle.NEWOBJ)),
        "object": extra(Steps(pickle.MARK + assembled(DTYPE) + pickle.OBJ)),
        "persistent_id": extra(Steps(pickle.PERSID + b"x\n")),
        "extension": extra(Steps(pickle.EXT1 + b"\1")),
        # time and memory: the text or array of a field has 2^30 parts, or a size becomes memory
        **{f"shared_lists_{key}": scenario({key: lists}) for key in ("scenario_id", "dataset")},
        **{f"shared_lists_{key}": scenario({key: lists}) for key in ("sample_rate", "sdc_id")},
        "shared_lists_map": scenario({"map": lists}),
        "shared_lists_time_stamps": scenario({"ts": nested([0.0])}),
        "shared_lists_origin": scenario({"ccdiff_env": {"origin": nested([0.0])}}),
        "shared_lists_type": scenario(tracks={"a": track() | {"type": lists}}),
        "shared_lists_category": scenario(tracks={"a": track() | {"metadata": {"type": lists}}}),
        "shared_lists_exit_lanes": lane(line, exit_lanes=lists),
        "shared_lists_polyline": lane(nested([0.0])),
        "shared_lists_heading": heading(nested([0.0])),
        "shared_tuples_as_a_key": scenario({tuples: 1}),  # the hash has no end
        "shared_tuples_in_a_set": extra(Call(Name("builtins", "set"), ([tuples],))),
        "numbers_of_one_hash": extra(Steps(b"}(" + numbers + b"u")),
        "numbers_of_one_hash_in_a_set": extra(
            Steps(b"\x8f(" + numbers.replace(b"N\x8a", b"\x8a")[:-1] + b"\x90")
        ),
        "punycode": extra(Call(Name("_codecs", "encode"), ("ü" * 20_000, "punycode"))),
        "bytearray_of_an_exbibyte": extra(Steps(pickle.BYTEARRAY8 + struct.pack("<Q", 1 << 60))),
        "one_line_in_2000_lanes": scenario(
            features={
                "0": {**street, "polyline": zigzag},
                **{str(i): {**street, "polyline": Steps(b"h\0")} for i in range(1, 2000)},
            }
        ),
        "lanes_that_share_a_list_of_lanes": scenario(
            features={
                "0": {
                    **street,
                    "polyline": line,
                    "exit_lanes": Steps(assembled([str(i) for i in range(4000)]) + b"q\0"),
                },
                **{
                    str(i): {**street, "polyline": line, "exit_lanes": Steps(b"h\0")}
                    for i in range(1, 4000)
                },
            }
        ),
        **{f"line_of_{x:g}_m": lane([[0.0, 0.0], [x, 0.0]]) for x in (3e7, 1e12, 1e300)},
        # fields of another kind
        "number_without_end": heading([0.0] * (STEPS - 1) + [10**400]),
        "length_without_end": pickle.dumps({"length": 10**5000}, 4),
        "metadata_of_a_track_is_a_list": scenario(tracks={"a": track() | {"metadata": [1]}}),
        "exit_lanes_are_a_number": lane(line, exit_lanes=7),
        "polyline_is_a_number": lane(7),
        "time_stamps_are_text": scenario({"ts": "now"}),
    }


def harmless() -> dict[str, bytes]:
    """Return descriptions with odd parts that nobody looks at."""
    return {
        "memo_of_64_gib": extra(Steps(assembled(1) + pickle.LONG_BINPUT + b"\xff\xff\xff\xff")),
        "nested_50000_deep": extra(Steps(b"]" * 50_000 + pickle.APPEND * 49_999)),
        "numbers_as_keys": extra(dict.fromkeys(range(5000))),
        "sets": extra([Call(Name("builtins", name), ([1, "x"],)) for name in ("set", "frozenset")]),
    }
