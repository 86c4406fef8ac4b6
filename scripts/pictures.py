#!/usr/bin/env python3
"""Make docs/pictures again ('make pictures'): nothing there is drawn by hand.

'scripts/pictures.py FOLDER NAME' makes NAME_1.png and so on of a recording of the first hour, which lies in FOLDER
('scripts/qgis-matrix --first-hour').

The recording whole_way.gif needs Pillow.

Takes the demo's results ('make demo' makes them first), the report as Chromium shows it, screenshots of the desktop
tests, and, where the shared data lies beside the project, the DSM of a real Pleiades pair, the report of a real
triplet, and the heights of a town at two dates. Pictures that cannot be made here are named and stay as they are.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile

from osgeo import gdal

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
FOLDER = os.path.join(ROOT, "docs", "pictures")
DEMO = os.path.join(ROOT, "demo")
SHARED = os.path.join(os.path.dirname(ROOT), "shared", "data")
SHOWN = {
    "pipeline_toolbox.png": "toolbox.png",
    "pipeline_dialog.png": "dialog.png",
    "pipeline_log.png": "log.png",
    "pipeline_map.png": "map.png",
    "errormap_map.png": "error_map.png",
    "inspect_map.png": "inspect.png",
    "control_points_window.png": "control_points.png",
    "surface_editing_edited.png": "editing.png",
    "next_step_after.png": "registered.png",
    "menu_first_steps.png": "first_steps.png",
    "install_dialog.png": "install.png",
}
# Of the first hour, in the order of docs/guide.md; the screen has an edge around QGIS's window.
RECORDED = ("1_panel", "3_running", "5_dsm", "6_map")
WINDOW, SMALL = (1280, 860), (960, 645)
MAX_BYTES = 390_000
RING = 0xD0, 0x1C, 0x1C  # of tests/qgis/drive_whole_way.py
SHARES = 1.0, 0.85, 0.7, 0.55
sys.path.insert(0, ROOT)


def say(text: str) -> None:
    sys.stdout.write(text + "\n")


def keep(path: str, name: str, most: int = MAX_BYTES) -> None:
    """Put a picture into docs/pictures: with 256 colours, and smaller, where it would have too many bytes otherwise."""
    target = os.path.join(FOLDER, name)
    shutil.copyfile(path, target)
    for share in SHARES:
        if os.path.getsize(target) <= most:
            break
        few_colours(path, target, share)
    say(f"  {name:<18}{os.path.getsize(target) / 1000:6.0f} kB")


def few_colours(path: str, target: str, share: float) -> None:
    """Write a picture with 256 colours, at a share of its width and height."""
    whole = gdal.Open(path)
    size = [round(share * length) for length in (whole.RasterXSize, whole.RasterYSize)]
    source = gdal.Translate(
        "", whole, format="MEM", bandList=[1, 2, 3], width=size[0], height=size[1], resampleAlg="average"
    )
    bands = [source.GetRasterBand(i) for i in (1, 2, 3)]
    colours = gdal.ColorTable()
    gdal.ComputeMedianCutPCT(*bands, 256, colours)
    few = gdal.GetDriverByName("MEM").Create("", *size, 1)
    gdal.DitherRGB2PCT(*bands, few.GetRasterBand(1), colours)
    few.GetRasterBand(1).SetColorTable(colours)
    gdal.GetDriverByName("PNG").CreateCopy(target, few, options=["ZLEVEL=9"])
    if os.path.exists(target + ".aux.xml"):
        os.unlink(target + ".aux.xml")


def shaded(dsm: str, name: str, size: int, folder: str) -> None:
    """A shaded DSM on white."""
    from repm_qgis.reports import pictures

    heights, cell = pictures.preview(dsm, size)
    relief = pictures.shaded_relief(heights, cell)
    relief[relief[..., 3] == 0] = 255
    path = os.path.join(folder, name)
    with open(path, "wb") as stream:
        stream.write(pictures.png_bytes(relief[..., :3]))
    keep(path, name)


def two_dates(folder: str) -> None:
    """A town before and after an earthquake, shaded, and what changed: gained red, lost blue. Heights only."""
    import numpy as np

    from benchmarks.earthquake import dates
    from repm_qgis.reports import pictures

    if not os.path.isdir(os.path.join(SHARED, "pleiades_two_dates")):
        say("  the picture of two dates is left as it is: no pleiades_two_dates")
        return
    made = dates()
    surfaces = [
        pictures.preview(str(path), 440) for path in (made.before / "dsm.tif", made.after / "registered_dsm.tif")
    ]
    both = np.concatenate([heights.ravel() for heights, _ in surfaces])
    low, high = pictures.percentile_range(both)
    panels = [pictures.shaded_relief(heights, cell, low, high) for heights, cell in surfaces]
    change, _ = pictures.preview(str(made.change / "significant_none.tif"), 440)
    light = panels[0][..., :3].mean(axis=-1, keepdims=True) * 0.4 + 153.0
    drawn = np.concatenate([np.repeat(light, 3, axis=-1).astype(np.uint8), panels[0][..., 3:]], axis=-1)
    rows, columns = (min(drawn.shape[axis], change.shape[axis]) for axis in (0, 1))
    coloured = pictures.colour_map(change[:rows, :columns], -20.0, 20.0, "diverging")
    seen = np.isfinite(change[:rows, :columns])[..., None]
    drawn[:rows, :columns] = np.where(seen, coloured, drawn[:rows, :columns])
    height = min(panel.shape[0] for panel in (*panels, drawn))
    white = np.full((height, 8, 3), 255, np.uint8)
    parts = []
    for panel in (*panels, drawn):
        panel = np.where(panel[:height, :, 3:] == 0, np.uint8(255), panel[:height, :, :3])
        parts += [panel, white]
    path = os.path.join(folder, "earthquake.png")
    with open(path, "wb") as stream:
        stream.write(pictures.png_bytes(np.hstack(parts[:-1])))
    keep(path, "earthquake.png")


def real(data: str, folder: str) -> str:
    """Run the pipeline on real images of the shared data; gives the folder of the results, "" without the data."""
    images = os.path.join(SHARED, data)
    if not os.path.isdir(images):
        say(f"  pictures of {data} are left as they are: no {images}")
        return ""
    made = os.path.join(folder, data)
    os.makedirs(made)
    names = sorted(name for name in os.listdir(images) if name.startswith("img_") and name.endswith(".tif"))
    subprocess.run(
        [
            os.path.join(ROOT, "scripts", "qgis-headless"),
            "run",
            "repm:pipeline",
            "--",
            *(f"IMAGES={images}/{name}" for name in names),
            "RESOLUTION=0.5",
            f"OUTPUT={made}/dsm.tif",
            f"CONFIDENCE={made}/confidence.tif",
            f"WORKSPACE={made}",
            f"REPORT={made}/report.html",
        ],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    return made


def report(source: str, name: str, height: int, folder: str, kind: str = "report.html") -> None:
    """A report of a run as Chromium shows it, from the top."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if not browser:
        say(f"  {name} is left as it is: no Chromium here")
        return
    path, page = os.path.join(folder, name), os.path.join(folder, "report.html")
    with open(os.path.join(source, kind), encoding="utf-8") as text, open(page, "w", encoding="utf-8") as copy:
        # The picture must not show folders of this machine.
        copy.write(text.read().replace(source + os.sep, "").replace(SHARED + os.sep, ""))
    subprocess.run(
        [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
            "--hide-scrollbars",
            f"--user-data-dir={folder}/browser",
            f"--window-size=1000,{height}",
            f"--screenshot={path}",
            f"file://{page}",
        ],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    keep(path, name)


def desktop(folder: str) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "no:pytest_qgis",
            "-q",
            f"--basetemp={folder}/work",
            "tests/qgis/test_desktop.py",
            "tests/qgis/test_install.py",
            "tests/qgis/test_menu.py",
            "tests/qgis/test_control_points.py",
            "tests/qgis/test_surface_editing.py",
            "tests/qgis/test_next_step.py",
        ],
        cwd=ROOT,
        env={**os.environ, "REPM_KEEP_PICTURES": folder},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        say(f"  the desktop's pictures are left as they are: {done.stdout.splitlines()[-1]}")
        return
    for source, name in SHOWN.items():
        keep(os.path.join(folder, source), name)
    recording(folder, "whole_way_", "whole_way.gif")


def recording(folder: str, source: str, name: str) -> None:
    """The pictures of a driver's clicks, in the order of their numbers, as one that moves."""
    try:
        from PIL import Image
    except ImportError:
        say(f"  {name} is left as it is: no Pillow here")
        return
    size, corner = (720, 459), (0, 0, 1380, 880)  # the screen has an edge around QGIS's window
    frames = []
    for file in sorted(file for file in os.listdir(folder) if file.startswith(source)):
        with Image.open(os.path.join(folder, file)) as picture:
            frames.append(picture.convert("RGB").crop(corner).resize(size, Image.LANCZOS))
    some = [frames[round(part * (len(frames) - 1))] for part in (0, 0.15, 0.6, 1)]
    sheet = Image.new("RGB", (size[0], size[1] * len(some)))
    for row, frame in enumerate(some):
        sheet.paste(frame, (0, row * size[1]))
    colours = sheet.quantize(63, method=Image.MEDIANCUT)  # the same for all: only what changes takes bytes
    colours.putpalette([*colours.getpalette()[: 3 * 63], *RING])  # a thin ring has too few pixels to be chosen
    first, *more = (frame.quantize(palette=colours, dither=Image.NONE) for frame in frames)
    times = [1600] * len(more) + [4000]
    target = os.path.join(FOLDER, name)
    first.save(target, save_all=True, append_images=more, duration=times, loop=0, optimize=True)
    say(f"  {name:<18}{os.path.getsize(target) / 1000:6.0f} kB")


def first_hour(recording: str, name: str) -> None:
    """The pictures of a recording, small."""
    with tempfile.TemporaryDirectory() as folder:
        for number, step in enumerate(RECORDED, start=1):
            small = os.path.join(folder, f"{number}.png")
            cut = {"srcWin": [0, 0, *WINDOW], "width": SMALL[0], "height": SMALL[1], "resampleAlg": "cubic"}
            gdal.Translate(small, os.path.join(recording, f"first_hour_{step}.png"), bandList=[1, 2, 3], **cut)
            few_colours(small, os.path.join(FOLDER, f"{name}_{number}.png"), 1.0)


def main() -> int:
    gdal.UseExceptions()
    os.makedirs(FOLDER, exist_ok=True)
    if len(sys.argv) == 3:
        first_hour(*sys.argv[1:])
        return 0
    with tempfile.TemporaryDirectory() as folder:
        shaded(os.path.join(DEMO, "dsm.tif"), "demo_dsm.png", 640, folder)
        report(DEMO, "report.png", 1500, folder)
        report(DEMO, "comparison.png", 1250, folder, "accuracy_none.html")
        desktop(folder)
        pair = real("pleiades_pair", folder)
        if pair:
            shaded(os.path.join(pair, "dsm.tif"), "pleiades_dsm.png", 640, folder)
        two_dates(folder)
        triplet = real("pleiades_triplet", folder)
        if triplet:
            report(triplet, "report_triplet.png", 1900, folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
