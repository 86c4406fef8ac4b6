"""A terrain by another library, in an interpreter that has it: ``python terrain_libraries.py NAME DSM DTM``.

The libraries are bulldozer-dtm and cloth-simulation-filter, with rasterio, in an environment of their own, whose
interpreter REPM_TERRAIN_PYTHON names: the project does not use them.
"""

from __future__ import annotations

import glob
import os
import shutil
import sys
import tempfile

import numpy as np
import rasterio
from rasterio.fill import fillnodata


def bulldozer(dsm: str, dtm: str) -> None:
    from bulldozer.pipeline.bulldozer_pipeline import dsm_to_dtm

    with tempfile.TemporaryDirectory() as folder:
        dsm_to_dtm(dsm_path=os.path.abspath(dsm), output_dir=folder, nb_max_workers=1)
        (made,) = glob.glob(f"{folder}/*dtm*.tif") or glob.glob(f"{folder}/**/*DTM*.tif", recursive=True)
        shutil.copy(made, dtm)


def cloth(dsm: str, dtm: str) -> None:
    """The cells as points; those of the ground, and what lies between them interpolated by GDAL."""
    import CSF

    with rasterio.open(dsm) as source:
        heights, profile, transform = source.read(1).astype(np.float64), source.profile, source.transform
        known = heights != source.nodata
    rows, columns = np.nonzero(known)
    points = np.column_stack([columns * transform.a, rows * transform.e, heights[known]])
    csf = CSF.CSF()
    csf.params.bSloopSmooth, csf.params.cloth_resolution, csf.params.rigidness = False, 1.0, 2
    csf.params.time_step, csf.params.class_threshold = 0.65, 0.5
    csf.setPointCloud(points)
    ground, others = CSF.VecInt(), CSF.VecInt()
    csf.do_filtering(ground, others, False)
    chosen = np.array(ground)
    shown = np.zeros(heights.shape, bool)
    shown[rows[chosen], columns[chosen]] = True
    filled = fillnodata(heights.astype(np.float32), shown.astype(np.uint8), max_search_distance=500.0)
    with rasterio.open(dtm, "w", **{**profile, "driver": "GTiff", "dtype": "float32", "count": 1}) as target:
        target.write(filled.astype(np.float32), 1)


if __name__ == "__main__":
    {"bulldozer": bulldozer, "cloth": cloth}[sys.argv[1]](sys.argv[2], sys.argv[3])
