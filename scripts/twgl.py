#!/usr/bin/env python3
"""Make resources/viewer/twgl.js again, the WebGL library of the pages of 'repm:viewer': ``scripts/twgl.py [--check]``.

Fetches TWGL with npm, compares the package with its checksum, and bundles the functions that the viewer calls, with
esbuild; all versions are fixed here. The file begins with the library's licence. ``--check`` writes nothing, and says
whether the file in the repository is the one that would be written. Needs Node's npm and npx, and the npm registry.
"""

from __future__ import annotations

import base64
import hashlib
import pathlib
import subprocess
import sys
import tarfile
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = ROOT / "resources" / "viewer" / "twgl.js"
VERSION, ESBUILD = "7.0.0", "0.28.2"
SHA512 = (
    "9HHZ8emdZb2nKPU0FDIGDlkp6AD9rWFv7ThqdbmUqyBhD3WTQpLN",  # pragma: allowlist secret
    "+89w4B+YshGwD1fL6PMVpVKZqC0pikgmcA==",  # pragma: allowlist secret
)
"""Of the package, as the npm registry states it ("integrity"), in two parts."""
USED = (
    "createBufferInfoFromArrays createProgramInfo createTexture createVertexArrayInfo drawBufferInfo m4 "
    "setAttribInfoBufferFromArray setUniforms v3"
).split()


def fetched(folder: pathlib.Path) -> pathlib.Path:
    """The library's package, unpacked in a folder; the program ends where its checksum is another."""
    subprocess.run(["npm", "pack", "--silent", f"twgl.js@{VERSION}"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    packed = folder / f"twgl.js-{VERSION}.tgz"
    found = base64.b64encode(hashlib.sha512(packed.read_bytes()).digest()).decode()
    if found != "".join(SHA512):
        raise SystemExit(f"twgl: the package of version {VERSION} has the checksum {found}: it is not the known one.")
    with tarfile.open(packed) as archive:
        for name in ("package/LICENSE.md", "package/dist/7.x/twgl-full.module.js"):
            member = archive.extractfile(name)
            if member is None:
                raise SystemExit(f"twgl: {name} is no file of the package of version {VERSION}.")
            (folder / pathlib.PurePosixPath(name).name).write_bytes(member.read())
    return folder


def bundled(folder: pathlib.Path) -> bytes:
    """The functions that are used, in one script that begins with the licence."""
    (folder / "used.js").write_text(f'export {{ {", ".join(USED)} }} from "./twgl-full.module.js";\n')
    licence = (folder / "LICENSE.md").read_text(encoding="utf-8").strip()
    banner = f"/*! TWGL {VERSION}, https://twgljs.org\n\n{licence}\n*/"
    options = ["--bundle", "--minify", "--format=iife", "--global-name=twgl", "--legal-comments=none"]
    command = ["npx", "--yes", f"esbuild@{ESBUILD}", "used.js", *options, f"--banner:js={banner}", "--log-level=error"]
    return subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE).stdout


def main(arguments: list[str]) -> int:
    with tempfile.TemporaryDirectory() as name:
        script = bundled(fetched(pathlib.Path(name)))
    if "--check" in arguments:
        same = TARGET.read_bytes() == script
        sys.stdout.write(f"{TARGET.name}: {'as' if same else 'NOT as'} TWGL {VERSION} and esbuild {ESBUILD} make it\n")
        return 0 if same else 1
    TARGET.write_bytes(script)
    sys.stdout.write(f"{TARGET.name}: {len(script)} bytes, SHA-256 {hashlib.sha256(script).hexdigest()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
