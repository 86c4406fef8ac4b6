"""Broken and hostile RPC files: each must be refused with RpcInvalidError, or read as what it says, and nothing else.

``python benchmarks/fuzz_rpc.py [COUNT [SEED]]`` prints one table; ``fuzz`` gives the same as an object. An input that
is read as another model than the one it was made from is *different*, and it is explained only if a second, naive
reader (regular expressions; here, for this purpose) finds exactly the model's ninety numbers in the broken file: then
the file is a whole one that says something else. All other differences are *wrong*.
"""

from __future__ import annotations

import re
import struct
import sys
import tempfile
import time
import tracemalloc
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np
from osgeo import gdal

try:
    import resource
except ImportError:  # Windows
    resource = None

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from repm_qgis.errors import RpcInvalidError  # noqa: E402
from repm_qgis.rpc import Rpc  # noqa: E402
from repm_qgis.rpc.readers import read_rpc_file  # noqa: E402
from repm_qgis.simulation.scene import rpc_tags  # noqa: E402
from tests.engine.rpc.writers import RPC00A, RPC00B, WRITERS  # noqa: E402

MAX_MS = 1000.0
MAX_MB = 150.0

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
WORDS = (
    "1e400",
    "-1e400",
    "NaN",
    "nan",
    "inf",
    "-Infinity",
    "1e308",
    "0",
    "abc",
    "",
    "1,5",
    "0x1F",
    "1e-400",
    "1_000",
    "--5",
    "1.#QNAN",
    "9" * 5000,
    "1e999999999",
    "\u0661\u0662",
    "1 2",
    "5 feet",
    "true",
    "null",
    "{}",
    "&lol;",
    "&#xD800;",
    "&#49;",
    "&#0;",
    "1&#x110000;",
    "1e",
    "+",
    ".",
    "12px",
    "\u22125",
    "3.0.1",
)
ENTITIES = (
    '<!DOCTYPE a [<!ENTITY lol "lol"><!ENTITY lol2 "&lol;&lol;&lol;">]>',
    '<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    '<!ENTITY % x SYSTEM "http://127.0.0.1/x">',
    "<!ELEMENT a ANY>",
)
GARBAGE = (
    "",
    "LINE_OFF",
    "LINE_OFF: 1",
    "lineOffset = 3;",
    "<LINE_OFF>7</LINE_OFF>",
    '"row_offset": 4,',
    "]",
    "}",
    "(",
    ")",
    ");",
    "</Global_RFM>",
    "<Inverse_Model>",
    "END_GROUP = IMAGE",
    "BEGIN_GROUP = IMAGE",
    "1.0",
    "-5e-3,",
    "\x0c",
    "&#xD800;",
    "RFM_CORRECTION_PARAMETERS",
    "polynomial_format:  A",
    "<!-- -->",
    "<![CDATA[1]]>",
    "line_num_coeff_00:  1",
    "LINE_NUM_COEFF_1: 5",
    "LINE_NUM_COEFF: 1 2 3",
)


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


# --- breaking ---------------------------------------------------------------------------------------------------------

Rng = np.random.Generator


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


# --- the second reader ------------------------------------------------------------------------------------------------

_AXES = (
    ("row", "LINE", "line"),
    ("col", "SAMP", "samp"),
    ("lat", "LAT", "lat"),
    ("lon", "LONG", "long"),
    ("height", "HEIGHT", "height"),
)
Numbers = Dict[str, Tuple[float, ...]]


def naive(kind: str, data: bytes) -> Optional[Numbers]:
    """The ninety numbers as regular expressions find them; None where they do not. No check of anything else."""
    if kind == "GeoTIFF":
        return _naive_tiff(data)
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1", errors="replace")
    try:
        numbers = {
            f"{ours}_{end}": _find(kind, text, axis, end, theirs)
            for ours, axis, theirs in _AXES
            for end, theirs in (("off", theirs), ("scale", theirs))
        }
        for ours, axis, theirs in _AXES[:2]:
            for part in ("num", "den"):
                numbers[f"{ours}_{part}"] = _find(kind, text, axis, part, theirs)
    except (TypeError, IndexError, ValueError):  # a number is not there
        return None
    if kind == "DIMAP v2":
        numbers["row_off"] = (numbers["row_off"][0] - 1,)
        numbers["col_off"] = (numbers["col_off"][0] - 1,)
    if kind.startswith("OSSIM") and re.search(r"^polynomial_format:\s*A", text, re.MULTILINE):
        for name in ("row_num", "row_den", "col_num", "col_den"):
            of_term = dict(zip(RPC00A, numbers[name]))
            numbers[name] = tuple(of_term[term] for term in RPC00B)
    return numbers


def _floats(text: str) -> Tuple[float, ...]:
    return tuple(float(word.lower().replace("d", "e")) for word in re.findall(NUMBER, text))


def _find(kind: str, text: str, axis: str, end: str, theirs: str) -> Tuple[float, ...]:
    polynomial = end in ("num", "den")
    if kind == "RPB":
        name = theirs + {"off": "Offset", "scale": "Scale", "num": "NumCoef", "den": "DenCoef"}[end]
        return _floats(re.search(rf"\b{name}\s*=\s*([^;]*);", text)[1])
    if kind == "Maxar XML":
        name = axis + {"off": "OFFSET", "scale": "SCALE", "num": "NUMCOEF", "den": "DENCOEF"}[end]
        return _floats(re.search(rf"<{name}\b[^>]*>([^<]*)</", text)[1])
    if kind == "JSON rpcm":
        ours = {"LINE": "row", "SAMP": "col", "LAT": "lat", "LONG": "lon", "HEIGHT": "alt"}[axis]
        name = f"{ours}_{'offset' if end == 'off' else end}"
        return _floats(re.search(rf'"{name}"\s*:\s*(\[[^\]]*\]|[^,}}]*)', text)[1])
    name = f"{axis}_{end.upper()}"
    if kind == "JSON GDAL":
        return _floats(re.search(rf'"{name}{"_COEFF" * polynomial}"\s*:\s*"?([^",}}]*)', text)[1])
    if kind.startswith("DIMAP"):
        part = re.search(r"<(Inverse_Model|GroundtoImage_Values)\b.*?</\1", text, re.DOTALL)[0]
        find = lambda key, where: _floats(re.search(rf"<{key}\b[^>]*>([^<]*)</", where)[1])[0]  # noqa: E731
        return tuple(find(f"{name}_COEFF_0*{i}", part) for i in range(1, 21)) if polynomial else (find(name, text),)
    find = lambda key: _floats(re.search(rf"^\s*{key}\s*[:=]([^\n\r]*)", text, re.M | re.I)[1])[0]  # noqa: E731
    first = 0 if kind.startswith("OSSIM") else 1
    return tuple(find(f"{name}_COEFF_0*{i}") for i in range(first, first + 20)) if polynomial else (find(name),)


def _naive_tiff(data: bytes) -> Optional[Numbers]:
    """The RPC tag (50844) of a little-endian TIFF's first directory: two errors, ten normalisers, 80 coefficients."""
    try:
        (directory,) = struct.unpack_from("<I", data, 4)
        (count,) = struct.unpack_from("<H", data, directory)
        for entry in range(directory + 2, directory + 2 + 12 * count, 12):
            tag, kind, length, place = struct.unpack_from("<HHII", data, entry)
            if (tag, kind, length) == (50844, 12, 92):
                v = struct.unpack_from("<92d", data, place)
                numbers: Numbers = {
                    f"{ours}_{end}": (v[2 + 5 * half + axis],)
                    for axis, (ours, *_) in enumerate(_AXES)
                    for half, end in enumerate(("off", "scale"))
                }
                for index, name in enumerate(("row_num", "row_den", "col_num", "col_den")):
                    numbers[name] = v[12 + 20 * index : 32 + 20 * index]
                return numbers
    except struct.error:
        pass
    return None


def _says(rpc: Rpc, numbers: Optional[Numbers], digits: float) -> bool:
    """Whether a model holds these numbers; ``digits`` is the relative rounding on the way."""
    if numbers is None:
        return False
    for name, values in numbers.items():
        ours = np.atleast_1d(getattr(rpc, name))
        if ours.shape != (len(values),) or not np.allclose(ours, values, rtol=digits, atol=0.0):
            return False
    return True


# --- the run ----------------------------------------------------------------------------------------------------------


@dataclass
class Report:
    """What became of the inputs: counts by mutation, the ones that must not be, and the bounds."""

    inputs: int = 0
    refused: Counter = field(default_factory=Counter)
    identical: Counter = field(default_factory=Counter)
    different: Counter = field(default_factory=Counter)
    wrong: List[str] = field(default_factory=list)
    crashed: List[str] = field(default_factory=list)
    slowest_ms: float = 0.0
    slowest: str = ""
    peak_mb: float = 0.0
    peak: str = ""
    rss_mb: float = 0.0
    seconds: float = 0.0

    def table(self) -> str:
        """The report as text."""
        names = [mutation.__name__ for mutation in MUTATIONS]
        rows = [f"{'mutation':18}{'inputs':>8}{'refused':>9}{'same':>7}{'other numbers':>15}"]
        for name in names:
            counts = self.refused[name], self.identical[name], self.different[name]
            rows.append(f"{name:18}{sum(counts):8}{counts[0]:9}{counts[1]:7}{counts[2]:15}")
        totals = [sum(c.values()) for c in (self.refused, self.identical, self.different)]
        rows += [
            f"{'all':18}{self.inputs:8}{totals[0]:9}{totals[1]:7}{totals[2]:15}",
            f"wrong models: {len(self.wrong)}; other exceptions: {len(self.crashed)}",
            f"slowest: {self.slowest_ms:.1f} ms of CPU ({self.slowest}); most memory: {self.peak_mb:.1f} MB "
            f"({self.peak}); process grew by {self.rss_mb:.0f} MB; {self.seconds:.0f} s in all",
        ]
        return "\n".join(rows + self.wrong[:10] + self.crashed[:10])


def seeds(folder: Path) -> Dict[str, bytes]:
    """A whole file of each format."""
    rpc = example()
    whole = {name: write(rpc).encode() for name, write in WRITERS.items()}
    image = str(folder / "seed.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(image, 8, 8, 1)
    dataset.SetMetadata(rpc_tags(rpc), "RPC")
    dataset = None  # noqa: F841
    whole["GeoTIFF"] = Path(image).read_bytes()
    return whole


def fuzz(count: int, seed: int = 1, keep: Optional[Path] = None) -> Report:
    """Break whole files ``count`` times and read each; inputs that must not be are kept in the folder ``keep``."""
    rng = np.random.default_rng(seed)
    mutations, weights = list(MUTATIONS), np.array(list(MUTATIONS.values()))
    report, start = Report(), time.monotonic()
    rss = _most_memory_mb()
    with tempfile.TemporaryDirectory() as name:
        whole = seeds(Path(name))
        path = Path(name) / "input"
        original = {kind: _read_whole(path, data) for kind, data in whole.items()}
        tracemalloc.start()
        try:
            for number in range(count):
                kind = list(whole)[rng.integers(0, len(whole))]
                mutation = mutations[rng.choice(len(mutations), p=weights / weights.sum())]
                data = mutation(whole[kind], rng)
                path.write_bytes(data)
                label = f"{mutation.__name__} of {kind}, input {number}"
                before = len(report.wrong) + len(report.crashed)
                _one(report, path, data, kind, mutation.__name__, label, original[kind])
                if keep is not None and len(report.wrong) + len(report.crashed) > before:
                    (keep / f"{number}.{mutation.__name__}").write_bytes(data)
        finally:
            tracemalloc.stop()
    report.rss_mb = _most_memory_mb() - rss
    report.seconds = time.monotonic() - start
    return report


def _most_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 if resource else 0.0


def _read_whole(path: Path, data: bytes) -> Rpc:
    path.write_bytes(data)
    return read_rpc_file(str(path))


def _one(report: Report, path: Path, data: bytes, kind: str, mutation: str, label: str, original: Rpc) -> None:
    report.inputs += 1
    tracemalloc.reset_peak()
    held, began = tracemalloc.get_traced_memory()[0], time.process_time()
    rpc, trouble = None, ""
    try:
        rpc = read_rpc_file(str(path))
    except RpcInvalidError as error:
        if len(str(error)) > 1000 or "\n" in str(error).strip():
            trouble = "its message is no sentence"
    except BaseException as error:  # noqa: B036 - any other exception is what is looked for
        trouble = f"{type(error).__name__}: {error}"[:300]
    ms = (time.process_time() - began) * 1e3
    peak = (tracemalloc.get_traced_memory()[1] - held) / 1e6
    if ms > report.slowest_ms:
        report.slowest_ms, report.slowest = ms, label
    if peak > report.peak_mb:
        report.peak_mb, report.peak = peak, label
    if trouble:
        report.crashed.append(f"{label}: {trouble}")
    elif rpc is None:
        report.refused[mutation] += 1
    elif rpc == original:
        report.identical[mutation] += 1
    elif any(_says(rpc, naive(other, data), 1e-13 if kind == "GeoTIFF" else 1e-15) for other in (kind, *WRITERS)):
        report.different[mutation] += 1
    else:
        report.wrong.append(f"{label}: a model that the file does not hold")


def main() -> int:
    """Run, print, and say with the exit code whether all is well."""
    count, seed = (int(value) for value in (sys.argv[1:] + ["20000", "1"][len(sys.argv) - 1 :])[:2])
    report = fuzz(count, seed)
    print(report.table())
    good = not report.wrong and not report.crashed and report.slowest_ms < MAX_MS and report.peak_mb < MAX_MB
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
