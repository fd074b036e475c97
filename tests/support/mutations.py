"""Damaged and hostile variants of valid files, for hypothesis."""

from __future__ import annotations

import copy
import json
from typing import Any

from hypothesis import strategies as st

#: Numbers and texts that break what was not made for them.
_NASTY_NUMBERS = st.sampled_from([0, -1, 1, 2, 255, 2**31, 2**53, 10**9, 10**30, 0.5, -1e30, 1e300, 1e-300])
_NASTY_TEXTS = st.sampled_from(["", "..", "../x", "/etc/passwd", "http://x/y", "a\0b", "\n", "nan", "\ud800"])
_LEAVES = st.none() | st.booleans() | _NASTY_NUMBERS | _NASTY_TEXTS | st.floats()
JSON_VALUES = st.recursive(_LEAVES, lambda v: st.lists(v, max_size=3) | st.dictionaries(_NASTY_TEXTS, v, max_size=3))


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Some bytes overwritten, removed, inserted or repeated, or the end cut off."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(changed) - 1, 0)))
        match draw(st.sampled_from(["overwrite", "overwrite", "remove", "insert", "repeat", "cut"])):
            case "overwrite":
                new = draw(st.binary(min_size=1, max_size=8) | st.sampled_from([b"\xff" * 4, bytes(4), b"\x7f" * 8]))
                changed[at : at + len(new)] = new
            case "remove":
                del changed[at : at + draw(st.integers(1, 64))]
            case "insert":
                changed[at:at] = draw(st.binary(min_size=1, max_size=16))
            case "repeat":
                changed[at:at] = changed[at : at + draw(st.integers(1, 64))]
            case "cut":
                del changed[at:]
    return bytes(changed)


@st.composite
def reworded(draw: st.DrawFn, content: bytes) -> bytes:
    """Words of a text replaced by numbers and texts that break things."""
    words = content.split(b" ")
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(words) - 1))
        new = draw(_NASTY_NUMBERS.map(str) | _NASTY_TEXTS)
        words[at] = new.encode("utf-8", "surrogatepass") + (b"\n" if b"\n" in words[at] else b"")
    return b" ".join(words)


@st.composite
def altered(draw: st.DrawFn, document: dict[str, Any]) -> dict[str, Any]:
    """Values anywhere in a JSON document replaced or removed."""
    changed = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        place: Any = changed
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            if isinstance(place[key], dict | list) and place[key] and draw(st.integers(0, 3)):
                place = place[key]
                continue
            if draw(st.integers(0, 4)):
                place[key] = draw(JSON_VALUES)
            else:
                del place[key]
            break
    return changed


def dumped(document: Any) -> bytes:
    return json.dumps(document).encode()
