#!/usr/bin/env python3
"""Make docs/pictures again ('make pictures'): nothing there is drawn by hand.

'scripts/pictures.py NAME...' makes the pictures of these names, and those that are made together with them.
'scripts/pictures.py --recording FOLDER NAME' makes NAME_1.png and so on of a recording of the first hour, which lies in
FOLDER ('scripts/qgis-matrix --first-hour').

Takes the demo's results ('make demo' makes them first), pages as Chromium shows them, screenshots of the desktop's
tests and, where the shared data lies beside the project, images of Pleiades. Pictures that cannot be made here are
named and stay as they are. docs/pictures/README.md says what each picture shows, whose data it is made of, and under
which licence; tests/test_pictures.py compares it with MAKERS.

The recording whole_way.gif needs Pillow. The pictures of the first hour download the engine's packages (90 MB).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from typing import Callable, Dict, List, Tuple

from osgeo import gdal

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
FOLDER = os.path.join(ROOT, "docs", "pictures")
DEMO = os.path.join(ROOT, "demo")
SHARED = os.path.join(os.path.dirname(ROOT), "shared", "data")
# Tests of the desktop: the words that choose them, the screenshots that they keep, and the pictures that these become.
TESTS: Dict[str, Tuple[str, Dict[str, str]]] = {
    "tests/qgis/test_desktop.py": (
        "pipeline_in_the_desktop or empty_map or error_map or elevation_profile",
        {
            "pipeline_toolbox.png": "toolbox.png",
            "pipeline_dialog.png": "dialog.png",
            "pipeline_log.png": "log.png",
            "pipeline_map.png": "map.png",
            "errormap_map.png": "error_map.png",
            "inspect_map.png": "inspect.png",
            "profile_tool.png": "profile.png",  # from QGIS 3.26 on
        },
    ),
    "tests/qgis/test_install.py": ("offers_installs", {"install_dialog.png": "install.png"}),
    "tests/qgis/test_menu.py": ("three_steps", {"menu_first_steps.png": "first_steps.png"}),
    "tests/qgis/test_control_points.py": ("measured_by_mouse", {"control_points_window.png": "control_points.png"}),
    "tests/qgis/test_surface_editing.py": ("drawn_on_the_map", {"surface_editing_edited.png": "editing.png"}),
    "tests/qgis/test_next_step.py": (
        "run_compare_register or fifteen_clicks",
        {"next_step_after.png": "registered.png"},
    ),
}
SHOWN = {shot: name for _, shown in TESTS.values() for shot, name in shown.items()}
# Of the first hour, in the order of docs/guide.md; the screen has an edge around QGIS's window.
RECORDED = ("1_panel", "3_running", "5_dsm", "6_map")
WINDOW, SMALL = (1280, 860), (960, 645)
MAX_BYTES = 390_000
RING = 0xD0, 0x1C, 0x1C  # of tests/qgis/drive_whole_way.py
SHARES = 1.0, 0.85, 0.7, 0.55
# Of the town before the earthquake, EPSG:32637: its south with the high houses, west, north, east and south.
PART = 315160.0, 4161950.0, 315600.0, 4161560.0
sys.path.insert(0, ROOT)


class LeftError(Exception):
    """What a picture needs is not here, so that it stays as it is."""


class FailedError(Exception):
    """What makes a picture came to a bad end."""


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


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


def report(source: str, name: str, height: int, folder: str, kind: str = "report.html") -> None:
    """A report of a run as Chromium shows it, from the top."""
    from tests.browser import PROGRAM, Browser

    if PROGRAM is None:
        raise LeftError("no Chromium here")
    path, page = os.path.join(folder, name), os.path.join(folder, "report.html")
    with open(os.path.join(source, kind), encoding="utf-8") as text, open(page, "w", encoding="utf-8") as copy:
        # The picture must not show folders of this machine.
        copy.write(text.read().replace(source + os.sep, "").replace(SHARED + os.sep, ""))
    with Browser(os.path.join(folder, "browser"), (1000, height)) as browser:
        browser.open(page)
        browser.wait("document.readyState === 'complete'")
        browser.picture(path)
    keep(path, name)


# --- the demo ---


def demo(folder: str) -> None:
    """The DSM of 'make demo', its report, and the report of its comparison with the true surface."""
    if not os.path.exists(os.path.join(DEMO, "dsm.tif")):
        raise LeftError("no demo/dsm.tif, which 'make demo' makes")
    shaded(os.path.join(DEMO, "dsm.tif"), "demo_dsm.png", 640, folder)
    report(DEMO, "report.png", 1500, folder)
    report(DEMO, "comparison.png", 1250, folder, "accuracy_none.html")


def mosaic(folder: str) -> None:
    """A part of twelve DSMs of a simulated town, laid over each other as they are, and of their mosaic: hillshades with
    the light from the north-west, as QGIS draws them."""
    import numpy as np

    from benchmarks import mosaic as twelve
    from repm_qgis.contracts.stages import MOSAIC
    from repm_qgis.reports.pictures import gradients, hillshade, png_bytes
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    town = twelve.town()
    dsms = sorted(str(path) for path in town.glob("dsm_*.tif"))
    options = {
        "dsms": dsms,
        "confidences": [path.replace("dsm_", "confidence_") for path in dsms],
        "output": os.path.join(folder, "mosaic_of_twelve.tif"),
    }
    made = twelve.read(run_stage(MOSAIC, options, Silent()).output)
    rows, columns = np.s_[650:1150], np.s_[700:1200]
    shades = [
        hillshade(*gradients(heights, twelve.CELL))[rows, columns]
        for heights in (twelve.first_come(dsms, made.shape), made)
    ]
    gap = np.ones((shades[0].shape[0], 8), np.float32)
    path = os.path.join(folder, "mosaic.png")
    with open(path, "wb") as stream:
        stream.write(png_bytes(np.nan_to_num(np.hstack([shades[0], gap, shades[1]]) * 255).astype(np.uint8)))
    keep(path, "mosaic.png")


# --- real images ---


def shared(data: str) -> str:
    """A folder of the shared data."""
    images = os.path.join(SHARED, data)
    if not os.path.isdir(images):
        raise LeftError(f"no shared/data/{data} beside the project")
    return images


def real(data: str, folder: str) -> str:
    """Run the pipeline on real images of the shared data; gives the folder of the results."""
    images = shared(data)
    made = os.path.join(folder, data)
    os.makedirs(made)
    names = sorted(name for name in os.listdir(images) if name.startswith("img_") and name.endswith(".tif"))
    command = [os.path.join(ROOT, "scripts", "qgis-headless"), "run", "repm:pipeline", "--"]
    command += [f"IMAGES={images}/{name}" for name in names]
    command += ["RESOLUTION=0.5", f"OUTPUT={made}/dsm.tif", f"CONFIDENCE={made}/confidence.tif", f"WORKSPACE={made}"]
    done = subprocess.run(
        [*command, f"REPORT={made}/report.html"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False
    )
    if done.returncode:
        raise FailedError(f"repm:pipeline ended with {done.returncode} on {data}")
    return made


def pleiades_pair(folder: str) -> None:
    """The DSM of a real pair."""
    shaded(os.path.join(real("pleiades_pair", folder), "dsm.tif"), "pleiades_dsm.png", 640, folder)


def pleiades_triplet(folder: str) -> None:
    """The report of a real triplet."""
    report(real("pleiades_triplet", folder), "report_triplet.png", 1900, folder)


def earthquake(folder: str) -> None:
    """A town before and after an earthquake, shaded, and what changed: gained red, lost blue. Heights only."""
    import numpy as np

    shared("pleiades_two_dates")
    from benchmarks.earthquake import dates
    from repm_qgis.reports import pictures

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


def viewer(folder: str) -> None:
    """The page of 'repm:viewer' with the town before the earthquake: under its orthophoto, under the expected error of
    its heights, and its elevation with a profile."""
    shared("pleiades_two_dates")
    from benchmarks.earthquake import dates
    from repm_qgis.contracts.stages import VIEWER
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage
    from tests.browser import PROGRAM, Browser

    if PROGRAM is None:
        raise LeftError("no Chromium here")
    made = {}
    for source, name in (("dsm", "town"), ("ortho", "ortho"), ("confidence", "confidence")):
        made[source] = os.path.join(folder, f"{name}.tif")
        gdal.Translate(made[source], str(dates().before / f"{source}.tif"), projWin=PART)
    page = run_stage(VIEWER, {**made, "viewer": os.path.join(folder, "viewer.html")}, Silent()).viewer
    with Browser(os.path.join(folder, "viewer_browser"), (980, 640)) as browser:
        browser.open(page)
        browser.wait("document.title === 'town' && document.documentElement.dataset.ready", 120)
        for key, times, shift in VIEW:
            for _ in range(times):
                browser.key(key, shift)
        for key, name in (("2", "viewer_ortho.png"), ("3", "viewer_error.png"), ("1", "viewer.png")):
            browser.key(key)
            if name == "viewer.png":
                browser.key("p")
                for place in LINE:
                    browser.click(*place)
                browser.mouse("Moved", POINTER)
            browser.evaluate("document.activeElement.blur()")
            path = os.path.join(folder, name)
            browser.picture(path)
            keep(path, name, 300_000)


# Key, times, and whether with Shift: nearer, turned, tilted, and to the left of the page's panel.
VIEW = (("+", 3, False), ("ArrowRight", 12, True), ("ArrowDown", 2, True), ("ArrowRight", 2, False))
LINE = (120, 370), (690, 250)  # ends of the profile, px
POINTER = 400, 520  # on its chart


# --- the desktop ---


def tested(folder: str, path: str, words: str, **variables: str) -> None:
    """Run the desktop tests of a file that words choose; they keep their screenshots in a folder."""
    options = ("-p", "no:pytest_qgis", "-q", f"--basetemp={folder}/t", path, "-k", words)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=ROOT,
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen", "REPM_KEEP_PICTURES": folder, **variables},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        lines = done.stdout.splitlines()
        raise FailedError("; ".join([line for line in lines if line.startswith("FAILED")] or lines[-1:]))


def desktop(folder: str) -> None:
    """Screenshots of the desktop's tests, and the recording of one of them."""
    failed = []
    for path, (words, shown) in TESTS.items():
        try:
            tested(folder, path, words)
        except FailedError as reason:
            failed.append(str(reason))
            continue
        for shot, name in shown.items():
            if os.path.exists(os.path.join(folder, shot)):
                keep(os.path.join(folder, shot), name)
            else:
                say(f"  {name}: left as it is: its test is skipped here (see 'pytest {path}')")
        if "fifteen_clicks" in words:
            recording(folder, "whole_way_", "whole_way.gif")
    if failed:
        raise FailedError("; ".join(failed))


def recording(folder: str, source: str, name: str) -> None:
    """The pictures of a driver's clicks, in the order of their numbers, as one that moves."""
    try:
        from PIL import Image
    except ImportError:
        say(f"  {name}: left as it is: no Pillow here")
        return
    shots = sorted(file for file in os.listdir(folder) if file.startswith(source))
    if not shots:
        say(f"  {name}: left as it is: its test is skipped here")
        return
    size, corner = (720, 459), (0, 0, 1380, 880)  # the screen has an edge around QGIS's window
    frames = []
    for file in shots:
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


def first_hour(folder: str) -> None:
    """From the zip to a DSM in this machine's QGIS."""
    tested(folder, "tests/qgis/test_install.py", "seven_clicks", REPM_FIRST_HOUR="1")
    if not os.path.exists(os.path.join(folder, f"first_hour_{RECORDED[0]}.png")):
        raise LeftError("its test is skipped here (see 'pytest tests/qgis/test_install.py')")
    recorded(folder, "first_hour")


def recorded(folder: str, name: str) -> None:
    """The pictures of a recording of the first hour, small."""
    for number, step in enumerate(RECORDED, start=1):
        small = os.path.join(folder, f"{name}_{number}.tif")
        cut = {"srcWin": [0, 0, *WINDOW], "width": SMALL[0], "height": SMALL[1], "resampleAlg": "cubic"}
        gdal.Translate(small, os.path.join(folder, f"first_hour_{step}.png"), bandList=[1, 2, 3], **cut)
        few_colours(small, os.path.join(FOLDER, f"{name}_{number}.png"), 1.0)
        os.unlink(small)
        say(f"  {name}_{number}.png")


FIRST_HOUR = tuple(f"first_hour_{number}.png" for number in range(1, len(RECORDED) + 1))
# What makes which pictures. Those of the first hour on QGIS 3.40 are made of a recording, with 'recorded'.
MAKERS: Dict[Callable[[str], None], Tuple[str, ...]] = {
    viewer: ("viewer.png", "viewer_ortho.png", "viewer_error.png"),
    earthquake: ("earthquake.png",),
    pleiades_pair: ("pleiades_dsm.png",),
    pleiades_triplet: ("report_triplet.png",),
    demo: ("demo_dsm.png", "report.png", "comparison.png"),
    mosaic: ("mosaic.png",),
    desktop: (*SHOWN.values(), "whole_way.gif"),
    first_hour: FIRST_HOUR,
}


def made(maker: Callable[[str], None], folder: str) -> bool:
    """Make pictures, in a folder of their own; False where that came to a bad end. Names those that are not made."""
    own = os.path.join(folder, maker.__name__)
    os.makedirs(own)
    try:
        maker(own)
    except (LeftError, FailedError) as reason:
        kept = (
            "left as they are" if isinstance(reason, LeftError) else "those that are not named above stay as they are"
        )
        say(f"  {', '.join(MAKERS[maker])}: {kept}: {reason}")
        return isinstance(reason, LeftError)
    return True


def main(arguments: List[str]) -> int:
    gdal.UseExceptions()
    if arguments[:1] == ["--recording"] and len(arguments) == 3:
        recorded(*arguments[1:])
        return 0
    unknown = sorted(set(arguments) - {name for names in MAKERS.values() for name in names})
    if unknown:
        say(f"pictures: nothing here makes '{unknown[0]}': see docs/pictures/README.md.")
        return 2
    wanted = [maker for maker, names in MAKERS.items() if not arguments or set(names) & set(arguments)]
    with tempfile.TemporaryDirectory(prefix="repm_") as folder:
        os.environ["REPM_BENCH_CACHE"] = os.path.join(folder, "cache")  # nothing that an earlier revision made
        return 0 if all([made(maker, folder) for maker in wanted]) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
