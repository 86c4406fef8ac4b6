"""The page of a surface for the browser: its size, what it takes to make it, and how soon a browser shows it.

Chromium without a graphics card loads and draws it, so these are the times of a slow device.
"""

from __future__ import annotations

import os
import tempfile
from typing import List, Sequence

import numpy as np

from benchmarks.clouds import NORTH, WEST, heights
from benchmarks.runner import alone, few, is_quick, say, stage
from benchmarks.tables import table
from repm_qgis.contracts.stages import VIEWER
from tests.browser import PROGRAM, Browser

SIDES = (1000, 2000, 4000)
READY = "document.title === '{}' && document.documentElement.dataset.ready"
# Frames of a view that turns, each waited for.
TURN = """(async () => {
  const begin = performance.now();
  for (let i = 0; i < 20; i++) {
    document.body.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowRight", shiftKey: true, bubbles: true}));
    await new Promise(requestAnimationFrame);
  }
  return 20000 / (performance.now() - begin);
})()"""


def make(folder: str, side: int) -> None:
    """A DSM with noise of 0.1 m, its orthophoto and its expected error."""
    import pyproj

    from repm_qgis.imagery.raster import write

    numbers = np.random.default_rng(0)
    place, crs = (WEST, 0.5, 0, NORTH, 0, -0.5), pyproj.CRS("EPSG:32631").to_wkt()
    surface = heights(range(side), side) + numbers.normal(0, 0.1, (side, side))
    error = 0.3 + 0.1 * np.sin(np.arange(side) / 40) + numbers.normal(0, 0.02, (side, side))
    photo = np.clip(110 + 3 * (surface - 100) + numbers.normal(0, 6, surface.shape), 0, 255)
    write(f"{folder}/surface{side}.tif", [surface.astype(np.float32)], place, crs)
    write(f"{folder}/error{side}.tif", [error.astype(np.float32)], place, crs)
    write(f"{folder}/ortho{side}.tif", [photo.astype(np.uint8)], place, crs, nodata=None)


def page(folder: str, side: int) -> None:
    made = {"viewer": f"{folder}/surface{side}.html", "confidence": f"{folder}/error{side}.tif"}
    stage(VIEWER, dsm=f"{folder}/surface{side}.tif", ortho=f"{folder}/ortho{side}.tif", cells=side * side, **made)


def opened(folder: str, name: str) -> List[float]:
    """Seconds until a page is drawn, the median of three starts, and frames a second while it turns."""
    seconds: List[float] = []
    frames = 0.0
    for attempt in range(3):
        with Browser(f"{folder}/browser{name}{attempt}") as browser:
            browser.open(f"{folder}/{name}.html")
            seconds.append(int(browser.wait(READY.format(name), 120)) / 1000)
            frames = max(frames, float(browser.evaluate(TURN)))
    return [float(np.median(seconds)), frames]


def pages() -> List[str]:
    rows: List[List[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for side in few(SIDES):
            alone(make, folder, side)
            made = alone(page, folder, side)
            size = os.path.getsize(f"{folder}/surface{side}.html") / 1e6
            shown: Sequence[object] = ("not opened" if is_quick() else "no Chromium here", "")
            if PROGRAM and not is_quick():  # by software it draws for minutes on a busy machine
                shown = opened(folder, f"surface{side}")
            rows.append([side * side / 1e6, size, made.cpu_s, round(made.mib), *shown])
            say(rows[-1])
    return [
        "**A surface in the browser** (`repm:viewer`): simulated hills with blocks and noise of 0.1 m, an orthophoto "
        "and the expected error draped over them. Chromium draws by software alone (SwiftShader) in 1280 x 800 px; "
        "seconds are those from opening the file to the drawn surface, the median of three starts. The aim is 5 s for "
        "4 million cells.",
        table("Mcells | MB | CPU to make it, s | memory, MiB | until it is drawn, s | frames a second", rows),
    ]
