"""The rows of a PLY file, text or binary. Nothing is read that the file does not really hold."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.limits import MAX_SINGLE_LINES, MAX_TEXT_BYTES, MAX_TRIANGLES
from rfpp.scene.io.number_lines import LINES, characters, line_bounds, numbers

_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
          "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
          "double": "f8", "float64": "f8"}  # fmt: skip
_MAX_HEADER = 2**16

#: Of a list property: the lengths, and all entries one after the other.
Column = np.ndarray | tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Property:
    name: str
    dtype: np.dtype
    length: np.dtype | None = None  # of a list: the type of its length


@dataclass
class Element:
    """What the header says of one kind of rows; `order` is that of the header."""

    name: str
    count: int
    order: str
    properties: list[_Property] = field(default_factory=list)


@dataclass(frozen=True)
class Header:
    """Of a PLY file whose claims its size allows. `order` is "<", ">" or "" for text; `size` its length in bytes."""

    order: str
    elements: tuple[Element, ...]
    size: int


def columns_of(content: bytes) -> dict[str, dict[str, Column]]:
    """Element → property → its values. Raises SceneError: damaged, or with claims that its size belies."""
    header = read_header(content)
    return _from_bytes(content, header) if header.order else _from_text(content, header)


def read_header(content: bytes) -> Header:
    """The header, checked against the size of the file. Raises SceneError."""
    end = content.find(b"end_header", 0, _MAX_HEADER)
    line_end = content.find(b"\n", end)
    if not content.startswith(b"ply") or end < 0 or line_end < 0:
        raise SceneError("is not a PLY file with a whole header: export it again")
    order, elements = None, []
    for line in content[:end].decode("ascii", "replace").splitlines()[1:]:
        try:
            match line.split():
                case ["format", "ascii", *_]:
                    order = ""
                case ["format", form, *_]:
                    order = {"binary_little_endian": "<", "binary_big_endian": ">"}[form]
                case ["element", name, count]:
                    elements.append(Element(name, int(count), order))
                case ["property", "list", length, kind, name] if not length.startswith(("float", "double")):
                    elements[-1].properties.append(_Property(name, _dtype(order, kind), _dtype(order, length)))
                case ["property", "list", *_]:
                    raise ValueError  # no list has half an entry more, or infinitely many
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _dtype(order, kind)))
        except (KeyError, ValueError, IndexError, TypeError):
            raise SceneError(f"its header says '{one_line(line, 60)}': export it again") from None
    if order is None:
        raise SceneError("its header names no format: export it again")
    size = line_end + 1
    for element in elements:
        row = 2 if not order else sum((p.length or p.dtype).itemsize for p in element.properties)
        if not element.properties or element.count < 0 or element.count * row > len(content) + 1 - size:
            raise SceneError(f"its header claims {element.count:,} of '{one_line(element.name, 40)}', more than it "
                             "holds: copy or export it again")  # fmt: skip
        if element.count > MAX_TRIANGLES:
            raise SceneError(f"{element.count:,} rows of '{one_line(element.name, 40)}' are more than "
                             f"{MAX_TRIANGLES:,}: decimate it where it was made")  # fmt: skip
    return Header(order, tuple(elements), size)


def _from_bytes(content: bytes, header: Header) -> dict[str, dict[str, Column]]:
    columns, position = {}, header.size
    for element in header.elements:
        try:
            if all(p.length is None for p in element.properties):
                dtype = np.dtype([(f"{i}", p.dtype) for i, p in enumerate(element.properties)])
                rows = np.frombuffer(content, dtype, element.count, position)
                position += rows.nbytes
                columns[element.name] = {p.name: rows[f"{i}"] for i, p in enumerate(element.properties)}
            else:
                columns[element.name], position = _rows_with_lists(content, element, position)
        except ValueError:
            raise SceneError(f"ends within '{one_line(element.name, 40)}': copy or export it again") from None
    return columns


def _rows_with_lists(content: bytes, element: Element, position: int) -> tuple[dict[str, Column], int]:
    """The columns and where they end."""
    if element.count and (found := _equal_rows(content, element, position)):
        return found
    if element.count * len(element.properties) > MAX_TRIANGLES:
        raise SceneError(
            f"{element.count:,} rows of '{one_line(element.name, 40)}' with lists of different lengths are "
            f"more than {MAX_TRIANGLES // len(element.properties):,}: triangulate it where it was made"
        )
    # Where a list begins is known only after the one before it: first all places, then all values at once.
    begins, lengths = [array("q") for _ in element.properties], [array("q") for _ in element.properties]
    order = "big" if element.order == ">" else "little"
    for _ in range(element.count):
        for prop, begin, length in zip(element.properties, begins, lengths, strict=True):
            count = 1
            if prop.length is not None:
                size = prop.length.itemsize
                count = int.from_bytes(content[position : position + size], order, signed=prop.length.kind == "i")
                position += size
            begin.append(position)
            length.append(count)
            position += count * prop.dtype.itemsize
            if count < 0 or position > len(content):
                raise ValueError
    columns: dict[str, Column] = {}
    for prop, begin, length in zip(element.properties, begins, lengths, strict=True):
        values = _gathered(content, prop.dtype, np.array(begin), np.array(length))
        columns[prop.name] = values if prop.length is None else (np.array(length, np.int64), values)
    return columns, position


def _equal_rows(content: bytes, element: Element, position: int) -> tuple[dict[str, Column], int] | None:
    """All rows at once, where every list is as long as in the first row, as in most files."""
    fields, offset = [], position
    for number, prop in enumerate(element.properties):
        count = 1
        if prop.length is not None:
            count = int(np.frombuffer(content, prop.length, 1, offset)[0])
            fields.append((f"length {number}", prop.length))
            offset += prop.length.itemsize
        offset += max(count, 0) * prop.dtype.itemsize
        fields.append((f"{number}", prop.dtype, (max(count, 0),)))
    dtype = np.dtype(fields)
    if position + element.count * dtype.itemsize > len(content):
        return None
    rows = np.frombuffer(content, dtype, element.count, position)
    if any((rows[name] != rows[name][0]).any() or rows[name][0] < 0 for name in dtype.names if "length" in name):
        return None
    columns: dict[str, Column] = {}
    for number, prop in enumerate(element.properties):
        values = rows[f"{number}"].reshape(-1)
        columns[prop.name] = values if prop.length is None else (rows[f"length {number}"].astype(np.int64), values)
    return columns, position + rows.nbytes


def _gathered(content: bytes, dtype: np.dtype, begins: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """The values of all rows one after the other, of which each row has so many from its byte on."""
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    places = np.repeat(begins, lengths) + within * dtype.itemsize
    raw = np.frombuffer(content, np.uint8)[places[:, None] + np.arange(dtype.itemsize)]
    return raw.reshape(-1).view(dtype)


def _from_text(content: bytes, header: Header) -> dict[str, dict[str, Column]]:
    if len(content) > MAX_TEXT_BYTES:
        raise SceneError(f"holds {len(content):,} bytes of text: save it as binary PLY")
    text = characters(content)
    bounds = line_bounds(text, header.size)
    columns: dict[str, dict[str, Column]] = {}
    first = single = 0
    for element in header.elements:
        if first + element.count >= len(bounds):
            raise _damaged(element)
        chunks = []
        for begin in range(first, first + element.count, LINES):
            end = min(begin + LINES, first + element.count)
            rows = _rows(element, text, bounds[begin : end + 1])
            if rows is None:
                single += end - begin
                if single > MAX_SINGLE_LINES:
                    raise SceneError(f"more than {MAX_SINGLE_LINES:,} rows of its text are not as its header says: "
                                     "save it as binary PLY")  # fmt: skip
                rows = _rows_one_by_one(element, content, bounds[begin : end + 1].tolist())
            chunks.append(rows)
        first += element.count
        columns[element.name] = {}
        for number, prop in enumerate(element.properties):
            lengths, values = (np.concatenate([np.empty(0), *(c[number][k] for c in chunks)]) for k in range(2))
            typed = _typed(values, prop)
            columns[element.name][prop.name] = typed if prop.length is None else (lengths.astype(np.int64), typed)
    return columns


#: For each property of an element, the length of each row's list (of one number: 1), and all values.
_Rows = list[tuple[np.ndarray, np.ndarray]]


def _rows(element: Element, text: np.ndarray, bounds: np.ndarray) -> _Rows | None:
    """Lines of an element that has one list at most; None: take them one by one."""
    lists = [place for place, prop in enumerate(element.properties) if prop.length is not None]
    found = numbers(text[bounds[0] : bounds[-1]], bounds - bounds[0])
    if found is None or len(lists) > 1 or not len(bounds) > 1:
        return None
    values, counts = found
    starts = np.cumsum(counts) - counts
    fixed = len(element.properties)
    lengths = np.zeros(len(counts))
    if lists:
        if counts.min() < lists[0] + 1:
            return None
        lengths = values[starts + lists[0]]
    if (counts != fixed + lengths).any() or (lengths < 0).any() or (lengths % 1).any():
        return None
    rows, shift = [], np.zeros(len(counts), np.int64)
    for place, prop in enumerate(element.properties):
        if prop.length is None:
            rows.append((np.ones(len(counts)), values[starts + shift + place]))
            continue
        many = lengths.astype(np.int64)
        within = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
        rows.append((many, values[np.repeat(starts + place + 1, many) + within]))
        shift = many
    return rows


def _rows_one_by_one(element: Element, content: bytes, bounds: list[int]) -> _Rows:
    values, lengths = [array("d") for _ in element.properties], [array("q") for _ in element.properties]
    for begin, end in pairwise(bounds):
        tokens = iter(content[begin:end].split())
        try:
            for prop, value, length in zip(element.properties, values, lengths, strict=True):
                count = 1 if prop.length is None else int(next(tokens))
                length.append(count)
                value.extend(float(next(tokens)) for _ in range(count))
        except (StopIteration, RuntimeError, ValueError, OverflowError):
            raise _damaged(element) from None
    return [(np.array(n), np.array(v)) for n, v in zip(lengths, values, strict=True)]


def _damaged(element: Element) -> SceneError:
    return SceneError(f"a row of '{one_line(element.name, 40)}' is damaged: export it again")


def _typed(values: np.ndarray, prop: _Property) -> np.ndarray:
    """Integers as such, so that a colour of text and of bytes is the same; those out of range are damage."""
    if prop.dtype.kind == "f":
        return values
    limits = np.iinfo(prop.dtype)
    if not ((values >= limits.min) & (values <= limits.max)).all():
        raise SceneError(f"'{one_line(prop.name, 40)}' is out of its range: export it again")
    return values.astype(prop.dtype)


def _dtype(order: str | None, kind: str) -> np.dtype:
    return np.dtype((order or "<") + _TYPES[kind])
