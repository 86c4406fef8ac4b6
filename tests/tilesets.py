"""Tilesets read back: a reader of GLB files of its own, Khronos' validator of glTF, and CesiumJS in Chromium."""

from __future__ import annotations

import functools
import http.server
import json
import pathlib
import shutil
import struct
import subprocess
import threading

import numpy as np
import pytest
from osgeo import gdal

from tests.browser import Browser

TOOL = pathlib.Path(__file__).resolve().parents[1] / "dist" / "tiles3d" / "tool"
KINDS = {5126: "<f4", 5125: "<u4", 5123: "<u2"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_glb(path):
    """The JSON of a GLB file, the bytes of its buffer views, and (N, width) arrays of its accessors."""
    data = pathlib.Path(path).read_bytes()
    magic, version, length, size = struct.unpack_from("<4sIII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    document, body = json.loads(data[20 : 20 + size]), data[28 + size :]
    views = [body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] for view in document["bufferViews"]]
    parts = []
    for accessor in document["accessors"]:
        part = np.frombuffer(views[accessor["bufferView"]], KINDS[accessor["componentType"]])
        parts.append(part.reshape(accessor["count"], WIDTHS[accessor["type"]]))
    return document, views, parts


def entries(entry, parent=None):
    yield entry, parent
    for child in entry.get("children", []):
        yield from entries(child, entry)


def enu(xyz):
    """Of glTF's axes, whose y is up: 3-D Tiles turn them so that z is."""
    return np.column_stack([xyz[:, 0], -xyz[:, 2], xyz[:, 1]]).astype(float)


def tool(package):
    """The folder of an npm package that 'make tiles3d-tools' has installed."""
    place = TOOL / "node_modules" / package
    if shutil.which("node") is None or not place.is_dir():
        pytest.skip(f"needs Node and the npm package {package}: run 'make tiles3d-tools'")
    return place


def gltf_issues(paths):
    """What Khronos' validator says of each GLB file."""
    script = """
    const fs = require("fs"), validator = require(process.argv[1]);
    (async () => { for (const path of process.argv.slice(2)) {
        const found = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)), {uri: path});
        console.log(JSON.stringify(found.issues)); } })();
    """
    done = subprocess.run(
        ["node", "-e", script, str(tool("gltf-validator")), *map(str, paths)], capture_output=True, text=True
    )
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0 and len(found) == len(paths), done.stderr
    return found


PAGE = """<!DOCTYPE html><script>window.CESIUM_BASE_URL = "/cesium";</script><script src="/cesium/Cesium.js"></script>
<style>html, body, div, canvas { margin: 0; width: 100%; height: 100%; }</style><div id="globe"></div><script>
window.failed = [];
const bare = { baseLayer: false, globe: false, skyBox: false, skyAtmosphere: false };
const widget = new Cesium.CesiumWidget("globe", bare);
Cesium.Cesium3DTileset.fromUrl("/tiles/tileset.json", { maximumScreenSpaceError: 1 }).then((tileset) => {
    /* style */
    tileset.tileFailed.addEventListener((event) => window.failed.push(event.url + event.message));
    const ready = () => { window.loaded = tileset.statistics.numberOfTilesWithContentReady; };
    tileset.allTilesLoaded.addEventListener(ready);
    widget.scene.primitives.add(tileset);
    const sphere = tileset.boundingSphere, back = new Cesium.HeadingPitchRange(0.4, -1.2, sphere.radius * 2);
    widget.camera.viewBoundingSphere(sphere, back);
}, (error) => window.failed.push(String(error)));
</script>"""


class Files(http.server.SimpleHTTPRequestHandler):
    """The page, CesiumJS and the tileset, from three places."""

    def __init__(self, *arguments, cesium, tiles, **keywords):
        self.places = {"cesium": cesium, "tiles": tiles}
        super().__init__(*arguments, **keywords)

    def translate_path(self, path):
        first, _, rest = path.split("?")[0].lstrip("/").partition("/")
        return str(self.places[first] / rest) if first in self.places else super().translate_path(path)

    def log_message(self, *_):
        pass


def drawn_by_cesium(tiles, folder, style=""):
    """How many tiles CesiumJS has loaded, and the (3, 600, 800) picture that it draws of a tileset from above.

    ``style`` is JavaScript that changes ``tileset`` first.
    """
    cesium = tool("cesium") / "Build" / "Cesium"
    (folder / "page.html").write_text(PAGE.replace("/* style */", style), encoding="utf-8")
    handler = functools.partial(Files, cesium=cesium, tiles=tiles, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Browser(folder / "profile", (800, 600)) as browser:
            browser.ask("Page.navigate", url=f"http://127.0.0.1:{server.server_port}/page.html")
            browser.wait("window.loaded || window.failed?.length", 120)
            assert browser.evaluate("window.failed") == []
            loaded = browser.evaluate("window.loaded")
            browser.picture(folder / "globe.png")
        server.shutdown()
    return loaded, gdal.Open(str(folder / "globe.png")).ReadAsArray()[:3]
