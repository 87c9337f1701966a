"""Mutators: what a hostile or unlucky hand makes of a valid file; all of it from one generator."""

import copy
import io
import json
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any

import msgpack
import numpy as np
import polars as pl
from flax import serialization

Rng = np.random.Generator
Mutator = Callable[[bytes, Sequence[bytes], Rng], bytes]

DEEP = 100_000  # nesting that no recursion survives
NUMBERS = (b"nan", b"inf", b"-inf", b"NaN", b"-Infinity", b"1e308", b"-1e308", b"1e999", b"5e-324")
NUMBERS = (*NUMBERS, b"-0", b"0", b"-1", b"1.5", b"9223372036854775808", b"1" + b"0" * 30)
NUMBERS = (*NUMBERS, b"9" * 400, b"7" * 5000, b"", b"0x10", b"1_0", b"null", "٣".encode(), b"true")
VALUES = (None, True, False, 0, -1, 1, 255, 2**31, 2**53 + 1, 2**62, 2**63 - 1, 10**30, 10**400)
VALUES = (*VALUES, 0.0, -0.5, 0.3, 1e9, 1e308, -1e308, 5e-324, float("nan"), float("inf"))
VALUES = (*VALUES, float("-inf"), "", "x", "\0", "a\nb", "../x", "ä\U0001f600", "\x1b[31m", "inf")
VALUES = (*VALUES, "y" * 3000, [], {}, [[]], [1, [2, [3]]], {"a": {"b": [None]}}, [0] * 300)


def pick(rng: Rng, values: Sequence[Any]) -> Any:
    return values[int(rng.integers(len(values)))]


# -- bytes -----------------------------------------------------------------------------------------


def flip(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """A few bits."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if out:
            out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def overwrite(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """A few bytes, often by the largest or smallest one."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if out:
            value = pick(rng, (0, 255, 127, 128, int(rng.integers(256))))
            out[int(rng.integers(len(out)))] = value
    return bytes(out)


def truncate(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def insert(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + rng.bytes(int(rng.integers(1, 40))) + data[at:]


def remove(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + data[at + int(rng.integers(1, 60)) :]


def repeat(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """A part of it once more, or many times."""
    start, end = sorted(rng.integers(len(data) + 1, size=2).tolist())
    return data[:end] + data[start:end] * int(pick(rng, (1, 2, 20))) + data[end:]


def splice(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """The beginning of one file and the end of another."""
    other = pick(rng, others)
    return data[: int(rng.integers(len(data) + 1))] + other[int(rng.integers(len(other) + 1)) :]


def noise(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Anything, behind the file's first bytes or not."""
    return data[: int(pick(rng, (0, 0, 4, 16)))] + rng.bytes(int(rng.integers(200)))


def number(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """One number of a text by a nasty one."""
    found = list(re.finditer(rb"-?[0-9]+(\.[0-9]+)?(e-?[0-9]+)?", data))
    if not found:
        return insert(data, others, rng)
    match = pick(rng, found)
    return data[: match.start()] + pick(rng, NUMBERS) + data[match.end() :]


def lines(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Lines in another order, twice, or not at all."""
    rows = data.splitlines(keepends=True)
    for _ in range(int(rng.integers(1, 4))):
        if len(rows) > 1:
            i, j = rng.integers(len(rows), size=2).tolist()
            what = int(rng.integers(3))
            if what == 0:
                rows[i], rows[j] = rows[j], rows[i]
            elif what == 1:
                rows.insert(i, rows[j])
            else:
                del rows[i]
    return b"".join(rows)


BYTES: tuple[Mutator, ...] = (
    flip,
    flip,
    overwrite,
    truncate,
    insert,
    remove,
    repeat,
    splice,
    noise,
)
TEXT: tuple[Mutator, ...] = (*BYTES, number, number, number, lines)


# -- trees of lists and mappings (JSON, msgpack) ---------------------------------------------------


def graft(tree: Any, rng: Rng, values: Sequence[Any] = VALUES) -> Any:
    """One node by another value, away, twice, or deeper."""
    spots: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        keys = range(len(node)) if isinstance(node, list) else list(node)
        for key in keys:
            spots.append((node, key))
            if isinstance(node[key], list | dict):
                walk(node[key])

    tree = copy.deepcopy(tree)
    if not isinstance(tree, list | dict) or rng.random() < 0.02:
        return pick(rng, values)
    walk(tree)
    if not spots:
        return pick(rng, values)
    parent, key = pick(rng, spots)
    what = rng.random()
    if what < 0.6:
        parent[key] = copy.deepcopy(pick(rng, values))
    elif what < 0.75:
        del parent[key]
    elif what < 0.85:
        parent[key] = pick(rng, ([parent[key]], {"x": parent[key]}, [parent[key]] * 3))
    elif what < 0.95:
        parent[key] = copy.deepcopy(pick(rng, spots)[0])
    elif isinstance(parent, dict):
        parent[pick(rng, ("x", "", "../x", "ä", "\0"))] = parent.pop(key)
    return tree


def tree_json(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    tree = json.loads(data)
    for _ in range(int(rng.integers(1, 4))):
        tree = graft(tree, rng)
    # `10**400` and its like are written digit by digit; NaN and Infinity as Python writes them.
    text = json.dumps(tree, ensure_ascii=bool(rng.integers(2)))
    return text.encode("utf-8", errors="replace")


def strange_json(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """What JSON may say and few expect."""
    at = int(rng.integers(1, len(data) + 1))
    where = data.find(b":", at) + 1 or at
    bad = pick(
        rng,
        (
            b"[" * DEEP,
            b"[" * DEEP + b"]" * DEEP,
            b'{"a":' * DEEP + b"1" + b"}" * DEEP,
            b"[" * 900 + b"]" * 900,
            b'"\\ud800"',
            b'"\\u0000\\u001b[2J"',
            b"9" * 4299,
            b"-" + b"9" * 4301,
            b"1e99999",
            b'{"a":1,"a":2}',
            b"\xef\xbb\xbf",
            b"\xff\xfe",
            b'"' + b"z" * 200_000 + b'"',
            b"[" + b"0," * 50_000 + b"0]",
        ),
    )
    kind = int(rng.integers(4))
    if kind == 0:
        return bad
    if kind == 1:
        return data.decode("utf-8", "replace").encode(pick(rng, ("utf-16", "utf-32", "utf-8-sig")))
    end = re.search(rb"[,}\]]", data[where:])
    return data[:where] + bad + data[where + (end.start() if end else 0) :]


JSON: tuple[Mutator, ...] = (*TEXT, *[tree_json] * 8, *[strange_json] * 2)


def tree_line(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """One line of JSON lines."""
    rows = data.splitlines(keepends=True)
    i = 0 if rng.random() < 0.3 else int(rng.integers(len(rows)))
    mutate = strange_json if rng.random() < 0.15 else tree_json
    rows[i] = mutate(rows[i].rstrip(b"\n"), others, rng) + b"\n"
    return b"".join(rows)


JSON_LINES: tuple[Mutator, ...] = (*TEXT, *[tree_line] * 10)


# -- XML -------------------------------------------------------------------------------------------

_LOL = "".join(
    f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' if i else '<!ENTITY l0 "lol">' for i in range(12)
)
_DOCTYPES = (
    f"<!DOCTYPE mujoco [{_LOL}]>",
    '<!DOCTYPE mujoco [<!ENTITY l11 SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE mujoco [<!ENTITY l11 SYSTEM "file:///dev/zero">]>',
    '<!DOCTYPE mujoco [<!ENTITY l11 SYSTEM "http://127.0.0.1:9/x">]>',
    '<!DOCTYPE mujoco SYSTEM "file:///dev/random">',
    '<!DOCTYPE mujoco [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>',
    '<!DOCTYPE mujoco [<!ENTITY l11 "&l11;">]>',
    f'<!DOCTYPE mujoco [<!ENTITY l11 "{"A" * 60_000}">]>',
)
_INSIDE = (
    '<include file="missing.xml"/>',
    '<include file="../../../../etc/passwd"/>',
    '<include file="/dev/zero"/>',
    '<include file="s.xml"/>',
    '<include file="file:///etc/passwd"/>',
    "<include/>",
    "&l11;",
    "&l11;" * 50,
    "&undefined;",
    "&#0;",
    "&#x110000;",
    "<![CDATA[<mujoco>]]>",
    "<?php x?>",
    "<!-- -- -->",
    '<x:body xmlns:x="urn:x"/>',
    "<body/>" * 3,
    "<body>" * DEEP,
    "<body>" * DEEP + "</body>" * DEEP,
    '<body name="object_1">' * 200 + "</body>" * 200,
    '<body name="object_' + "9" * 5000 + '"/>',
    "".join(f'<body name="object_{i}" pos="0.4 0 0.1"/>' for i in range(4, 3000)),
    "".join(f'<a{i} b="c"/>' for i in range(3000)),
    "<a " + " ".join(f'b{i}=""' for i in range(3000)) + "/>",
    "x" * 300_000,
    "\u0085\u2028\U0001f600",
)
_ATTRIBUTES = ("nan nan nan", "inf 0 0", "1e308 1e308 1e308", "1e999 0 0", "", " ", "0", "0 0 0")
_ATTRIBUTES = (*_ATTRIBUTES, "0.4 0.1", "0.4 0.1 0.18 7", "x" * 300_000, "1 " * 100_000, "&#10;")
_ATTRIBUTES = (*_ATTRIBUTES, "9" * 5000, "&lt;", "object_3", "object_99999", "cylinder", "free")
_ATTRIBUTES = (*_ATTRIBUTES, "\u0663 0 0", "1_0 0 0", "5e-324 0 0 0", "1e200 1e200 0 0", "&l11;")


def attribute(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """The value of one attribute."""
    found = list(re.finditer(rb'="([^"]*)"', data))
    if not found:
        return flip(data, others, rng)
    match = pick(rng, found)
    value = pick(rng, _ATTRIBUTES).encode()
    return data[: match.start(1)] + value + data[match.end(1) :]


def element(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """An element away, twice, or with something nasty beside it."""
    found = list(re.finditer(rb"<[a-z]+[^<>]*/>|</[a-z]+>", data))
    if not found:
        return flip(data, others, rng)
    match = pick(rng, found)
    what = rng.random()
    if what < 0.2:
        return data[: match.start()] + data[match.end() :]
    if what < 0.35:
        return data[: match.end()] + match[0] + data[match.end() :]
    return data[: match.end()] + pick(rng, _INSIDE).encode() + data[match.end() :]


def doctype(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Entities, and where they are used."""
    body = re.sub(rb"^<\?xml[^>]*\?>", b"", data)
    if rng.random() < 0.7:
        body = element(body, others, rng).replace(b"<worldbody>", b"<worldbody>&l11;", 1)
    return pick(rng, _DOCTYPES).encode() + body


def encoding(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """In another encoding than it says, or in one that nobody has."""
    body = re.sub(r"^<\?xml[^>]*\?>", "", data.decode("utf-8", "replace"))
    names = ("utf-8", "utf-16", "utf-16-le", "utf-32", "utf-7", "latin-1", "cp1252", "cp037")
    says = pick(rng, (*names, "klingon", "idna", "hex", "rot13", "undefined", "raw_unicode_escape"))
    content = body.encode(pick(rng, names), "replace")
    return f'<?xml version="1.0" encoding="{says}"?>'.encode() + content


XML: tuple[Mutator, ...] = (
    *TEXT,
    *[attribute] * 4,
    *[element] * 4,
    *[doctype] * 2,
    encoding,
)


# -- msgpack ---------------------------------------------------------------------------------------

_HEADERS = (
    b"\xdd\xff\xff\xff\xff",  # a list of 2^32 - 1
    b"\xdf\xff\xff\xff\xff",  # a mapping
    b"\xdb\xff\xff\xff\xff",  # text
    b"\xc6\xff\xff\xff\xff",  # bytes
    b"\xc9\xff\xff\xff\xff\x01",  # an extension
    b"\xc1",  # never used
    b"\x91" * DEEP + b"\x01",
    b"\x81\xa1a" * DEEP + b"\x01",
    b"\xd6\xff" + b"\xff" * 4,  # a time
    b"\xc7\x0c\xff" + b"\xff" * 12,
    b"\xd4\x01\x00",  # an array of Flax's, of one byte
    b"\x81\x91\x01\x01",  # a list for a key
    b"\xcf" + b"\xff" * 8,
)


def _array(rng: Rng) -> msgpack.ExtType:
    """An array as Flax packs it, with a shape or a type that it cannot have."""
    shape = pick(rng, ([], [0], [2**40], [-1], [2, 3], [2**31, 2**31], ["a"], "x", [1.5]))
    dtype = pick(rng, ("float32", "float64", "object", "O", "V8", "U4", "bfloat16", "no", "M8[s]"))
    content = (shape, dtype, pick(rng, (b"", b"\0" * 4, b"\0" * 24, b"\xff" * 24)))
    return msgpack.ExtType(int(pick(rng, (1, 1, 1, 2, 3, 127))), msgpack.packb(content) or b"")


def checkpoint(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """A payload that is wrong, under a digest that is right."""
    import hashlib

    try:
        outer = msgpack.unpackb(data)
        payload = outer["payload"]
    except Exception:
        return flip(data, others, rng)
    what = rng.random()
    if what < 0.25:
        payload = pick(rng, BYTES)(payload, [payload], rng)
    elif what < 0.4:
        at = int(rng.integers(len(payload) + 1))
        payload = payload[: pick(rng, (0, at))] + pick(rng, _HEADERS) + payload[at:]
    else:
        tree = msgpack.unpackb(payload, strict_map_key=False)
        values = (*[v for v in VALUES if not (isinstance(v, int) and abs(v) >= 2**64)], b"\0", -7)
        arrays = (_array(rng), _array(rng), msgpack.Timestamp(1, 1))
        floats = serialization.msgpack_serialize({"a": rng.normal(size=3).astype(np.float32)})
        arrays = (*arrays, msgpack.unpackb(floats)["a"])
        for _ in range(int(rng.integers(1, 3))):
            tree = graft(tree, rng, values if rng.random() < 0.6 else arrays)
        payload = msgpack.packb(tree)
    assert payload is not None
    outer |= {"payload": payload, "sha256": hashlib.sha256(payload).hexdigest()}
    if rng.random() < 0.1:
        outer = graft(outer, rng, (None, 1, 2, -1, "x", b"x", [], {}, 1.5, True))
    return msgpack.packb(outer) or b""


MSGPACK: tuple[Mutator, ...] = (*BYTES, *[checkpoint] * 12)


# -- Parquet ---------------------------------------------------------------------------------------


def footer(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Bytes of the footer: schema, counts, offsets, sizes."""
    if len(data) < 12:
        return flip(data, others, rng)
    size = min(struct.unpack("<I", data[-8:-4])[0], len(data) - 12)
    start = len(data) - 8 - size
    mutate = pick(rng, (flip, overwrite, overwrite, remove, insert, number))
    middle = mutate(data[start:-8], others, rng)
    tail = struct.pack("<I", len(middle) if rng.random() < 0.8 else int(rng.integers(2**32)))
    return data[:start] + middle + tail + data[-4:]


def pages(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Bytes of the pages, and of their headers."""
    if len(data) < 12:
        return flip(data, others, rng)
    size = min(struct.unpack("<I", data[-8:-4])[0], len(data) - 12)
    end = len(data) - 8 - size
    return pick(rng, (flip, overwrite))(data[4:end].join((b"PAR1", b"")), others, rng) + data[end:]


_TYPES = (pl.Int64, pl.Int8, pl.UInt64, pl.Float32, pl.Float64, pl.String, pl.Boolean, pl.Binary)
_NUMBERS = (0, -1, 1, 2**31, 2**62, 2**63 - 1, -(2**63))
_FLOATS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, -1.0, 0.0, 5e-324)
_TEXTS = ("", "x", "\0", "a\nb", "ä\U0001f600", "push", "reach", "go_on", "tight_0", "z" * 5000)


def _value(dtype: pl.DataType, rng: Rng) -> Any:
    if rng.random() < 0.15:
        return None
    if dtype == pl.List:
        inner = dtype.inner  # pyright: ignore[reportAttributeAccessIssue]
        return [_value(inner, rng) for _ in range(int(rng.integers(4)))]
    if dtype == pl.Boolean:
        return bool(rng.integers(2))
    return pick(rng, _TEXTS if dtype == pl.String else _FLOATS if dtype.is_float() else _NUMBERS)


def rows(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """A good Parquet file of another table."""
    try:
        frame = pl.read_parquet(io.BytesIO(data))
        metadata = dict(pl.read_parquet_metadata(io.BytesIO(data)))
    except Exception:
        return flip(data, others, rng)
    metadata.pop("ARROW:schema", None)
    for _ in range(int(rng.integers(1, 4))):
        frame = _changed(frame, rng)
    if metadata and rng.random() < 0.3:
        key = pick(rng, list(metadata))
        try:
            metadata[key] = tree_json(metadata[key].encode(), others, rng).decode()
        except ValueError:
            metadata[key] = pick(rng, ("", "{", "[]", "1", "[" * DEEP, '{"settings": 3}'))
    out = io.BytesIO()
    frame.write_parquet(out, metadata=metadata or None)
    return out.getvalue()


def _series(name: str, values: list, dtype: pl.DataType) -> pl.Series:
    try:
        return pl.Series(name, values, dtype=dtype, strict=False)
    except (OverflowError, TypeError, pl.exceptions.PolarsError):  # of a column changed before
        return pl.Series(name, [None] * len(values), dtype=dtype)


def _changed(frame: pl.DataFrame, rng: Rng) -> pl.DataFrame:
    what = rng.random()
    if not frame.columns:
        return frame
    name = pick(rng, frame.columns)
    dtype = frame.schema[name]
    if what < 0.45 and len(frame):
        values = frame[name].to_list()
        for _ in range(int(rng.integers(1, 4))):
            values[int(rng.integers(len(values)))] = _value(dtype, rng)
        return frame.with_columns(_series(name, values, dtype))
    if what < 0.55:
        return frame.with_columns(_series(name, [_value(dtype, rng)] * len(frame), dtype))
    if what < 0.62:
        return frame.drop(name)
    if what < 0.70:
        other = pick(rng, _TYPES)
        return frame.with_columns(pl.Series(name, [None] * len(frame), dtype=other))
    if what < 0.75:
        new = pick(rng, ("x", "", "a\nb", name + " "))
        return frame if new in frame.columns else frame.rename({name: new})
    if what < 0.80:
        return frame.select(pl.all().shuffle(seed=int(rng.integers(1000))))
    if what < 0.85:
        return pl.concat([frame, frame])
    if what < 0.90:
        return frame.head(int(rng.integers(3)))
    if what < 0.95:
        return frame.with_columns(pl.lit("p").alias("policy"), pl.lit(1).alias("robots"))
    return frame.select(pl.concat_list(name)) if len(frame) else frame.select(frame.columns[::-1])


def nested(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """Another table in a list of structs; or another origin, below the top."""
    try:
        frame = pl.read_parquet(io.BytesIO(data))
        metadata = dict(pl.read_parquet_metadata(io.BytesIO(data)))
        name = pick(rng, frame.columns)
        inner = frame[name].explode(empty_as_null=False).struct.unnest()
    except Exception:
        return flip(data, others, rng)
    metadata.pop("ARROW:schema", None)
    if rng.random() < 0.3:
        key = pick(rng, list(metadata))
        metadata[key] = tree_json(metadata[key].encode(), others, rng).decode()
    else:
        for _ in range(int(rng.integers(1, 4))):
            inner = _changed(inner, rng)
        if not inner.columns:
            return flip(data, others, rng)
        frame = frame.with_columns(inner.to_struct(name).implode())
    out = io.BytesIO()
    frame.write_parquet(out, metadata=metadata)
    return out.getvalue()


def declared(data: bytes, others: Sequence[bytes], rng: Rng) -> bytes:
    """No content, and a footer that promises anything."""
    return b"PAR1" + rng.bytes(int(rng.integers(100))) + struct.pack(
        "<I", int(pick(rng, (0, 4, 50, 2**31, 2**32 - 1)))
    ) + b"PAR1"  # fmt: skip


PARQUET: tuple[Mutator, ...] = (*BYTES, *[footer] * 4, *[pages] * 3, *[rows] * 7, declared)
NESTED: tuple[Mutator, ...] = (*PARQUET, *[nested] * 14)
