"""Ways to break an RPC file: bytes, lines, numbers, nesting, size and encoding; and the model that is broken."""

from __future__ import annotations

import re
from typing import Callable, Dict, List, Tuple

import numpy as np

from repm_qgis.rpc import Rpc
from tests.engine.rpc.writers import WRITERS

Rng = np.random.Generator

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
WORDS = (
    "1e400|-1e400|NaN|nan|inf|-Infinity|1e308|0|abc||1,5|0x1F|1e-400|1_000|--5|1.#QNAN|"
    + "9" * 5000
    + "|1e999999999|\u0661\u0662|1 2|5 feet|true|null|{}|&lol;|&#xD800;|&#49;|&#0;|1&#x110000;|"
    "1e|+|.|12px|\u22125|3.0.1"
).split("|")
ENTITIES = (
    '<!DOCTYPE a [<!ENTITY lol "lol"><!ENTITY lol2 "&lol;&lol;&lol;">]>',
    '<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    '<!ENTITY % x SYSTEM "http://127.0.0.1/x">',
    "<!ELEMENT a ANY>",
)
GARBAGE = (
    '|LINE_OFF|LINE_OFF: 1|lineOffset = 3;|<LINE_OFF>7</LINE_OFF>|"row_offset": 4,|]|}|(|)|);|</Global_RFM>|'
    "<Inverse_Model>|END_GROUP = IMAGE|BEGIN_GROUP = IMAGE|1.0|-5e-3,|\x0c|&#xD800;|RFM_CORRECTION_PARAMETERS|"
    "polynomial_format:  A|<!-- -->|<![CDATA[1]]>|line_num_coeff_00:  1|LINE_NUM_COEFF_1: 5|LINE_NUM_COEFF: 1 2 3"
).split("|")


def example() -> Rpc:
    """A model with all ninety numbers at work: 0.5 m px, 20 km a side, 15 degrees off nadir."""
    rng = np.random.default_rng(7)

    def polynomial(leading: Dict[int, float]) -> Tuple[float, ...]:
        values = rng.normal(0.0, 2e-5, 20)
        for index, value in leading.items():
            values[index] = value
        return tuple(values.tolist())

    return Rpc(
        18999.5,
        19000.0,
        20749.5,
        20750.0,
        43.6,
        0.09,
        1.44,
        0.13,
        500.0,
        400.0,
        polynomial({0: 0.002, 1: -0.21, 2: -1.02, 3: 0.012}),
        polynomial({0: 1.0}),
        polynomial({0: -0.001, 1: 1.01, 2: -0.2, 3: 0.009}),
        polynomial({0: 1.0}),
    )


def _lines(data: bytes) -> List[bytes]:
    return data.split(b"\n")


def random_bytes(data: bytes, rng: Rng) -> bytes:
    broken = bytearray(data)
    for place in rng.integers(0, len(data), rng.integers(1, 9)):
        broken[place] = rng.integers(0, 256)
    return bytes(broken)


def random_letters(data: bytes, rng: Rng) -> bytes:
    broken = bytearray(data)
    for place in rng.integers(0, len(data), rng.integers(1, 4)):
        broken[place] = rng.integers(32, 127)
    return bytes(broken)


def truncated(data: bytes, rng: Rng) -> bytes:
    return data[: rng.integers(0, len(data))]


def beheaded(data: bytes, rng: Rng) -> bytes:
    return data[rng.integers(1, len(data)) :]


def swapped_lines(data: bytes, rng: Rng) -> bytes:
    lines = _lines(data)
    a, b = rng.integers(0, len(lines), 2)
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def line_lost(data: bytes, rng: Rng) -> bytes:
    lines = _lines(data)
    first = rng.integers(0, len(lines))
    del lines[first : first + rng.integers(1, 4)]
    return b"\n".join(lines)


def line_twice(data: bytes, rng: Rng) -> bytes:
    lines = _lines(data)
    place = rng.integers(0, len(lines))
    lines.insert(rng.integers(0, len(lines)), lines[place])
    return b"\n".join(lines)


def line_inserted(data: bytes, rng: Rng) -> bytes:
    lines = _lines(data)
    lines.insert(rng.integers(0, len(lines)), GARBAGE[rng.integers(0, len(GARBAGE))].encode())
    return b"\n".join(lines)


def _replaced_number(data: bytes, rng: Rng, word: Callable[[bytes], bytes]) -> bytes:
    marks = list(re.finditer(rb"(?<![\w.])" + NUMBER.encode() + rb"(?![\w.])", data))
    if not marks:
        return data
    mark = marks[rng.integers(0, len(marks))]
    return data[: mark.start()] + word(mark[0]) + data[mark.end() :]


def number_to_word(data: bytes, rng: Rng) -> bytes:
    return _replaced_number(data, rng, lambda _: WORDS[rng.integers(0, len(WORDS))].encode())


def number_to_number(data: bytes, rng: Rng) -> bytes:
    return _replaced_number(
        data,
        rng,
        lambda old: repr(
            float(old.lower().replace(b"d", b"e")) * rng.uniform(0.9, 1.1) + rng.choice([0.0, 1e-7, 1e-3])
        ).encode(),
    )


def number_lost(data: bytes, rng: Rng) -> bytes:
    return _replaced_number(data, rng, lambda _: b"")


def number_twice(data: bytes, rng: Rng) -> bytes:
    return _replaced_number(data, rng, lambda old: old + rng.choice([b" ", b", ", b",\n", b"\n"]) + old)


def entities(data: bytes, rng: Rng) -> bytes:
    lines = _lines(data)
    lines.insert(rng.integers(0, min(len(lines), 4)), ENTITIES[rng.integers(0, len(ENTITIES))].encode())
    return b"\n".join(lines)


def deep(data: bytes, rng: Rng) -> bytes:
    depth = int(rng.choice([20, 70, 500, 20_000, 200_000]))
    opening, closing = ((b"<a>", b"</a>"), (b"[", b"]"), (b'{"rpc":', b"}"), (b"(", b")"))[rng.integers(0, 4)]
    place = rng.integers(0, len(data)) if rng.random() < 0.5 else 0
    return data[:place] + opening * depth + (data[place:] + closing * depth if rng.random() < 0.5 else data[place:])


def huge(data: bytes, rng: Rng) -> bytes:
    filler = (b" ", b"\n", b"0", b"<a/>", b"1 ", b"a='1' ", b"X: 1\n", b"[", b"-", b"\xff")[rng.integers(0, 10)]
    place, size = rng.integers(0, len(data)), int(rng.choice([10_000, 1_000_000, 8_000_000, 9_000_000]))
    return data[:place] + filler * (size // len(filler)) + data[place:]


def spliced(data: bytes, rng: Rng) -> bytes:
    other = WRITERS[list(WRITERS)[rng.integers(0, len(WRITERS))]](example()).encode()
    place, cut = rng.integers(0, len(data)), rng.integers(0, len(other))
    return (data + other, data[:place] + other[cut:], other + data)[rng.integers(0, 3)]


def encoding(data: bytes, rng: Rng) -> bytes:
    text = data.decode("latin-1")
    kind = rng.integers(0, 7)
    if kind < 4:
        return text.encode(("utf-16", "utf-8-sig", "utf-32", "utf-16-be")[kind])
    return (
        b"\xff\xfe" + data,
        b"\xef\xbb\xbf" * 2 + data,
        data.replace(b"degrees", "\u00b0".encode("latin-1")) + b"\n# \xe9t\xe9\n",
    )[kind - 4]


def noise(data: bytes, rng: Rng) -> bytes:
    return data[: rng.integers(0, 200)] + rng.bytes(int(rng.integers(0, 20_000)))


MUTATIONS: Dict[Callable[[bytes, Rng], bytes], float] = {
    random_bytes: 3,
    random_letters: 3,
    truncated: 2,
    beheaded: 1,
    swapped_lines: 2,
    line_lost: 1,
    line_twice: 1,
    line_inserted: 2,
    number_to_word: 4,
    number_to_number: 2,
    number_lost: 1,
    number_twice: 1,
    entities: 1,
    deep: 0.5,
    huge: 0.1,
    spliced: 1,
    encoding: 1,
    noise: 1,
}
"""Ways to break a file, and how often each is taken."""
