"""REPM engine: accurate surface models from satellite images with RPCs.

The method is that of Hong et al., "Refined Equivalent Pinhole Model for Large-scale 3D Reconstruction from
Spaceborne CCD Imagery". The engine knows nothing of QGIS; ``python -m repm_qgis STAGE JOB.json`` runs one stage.
"""

import warnings

__version__ = "0.1.0"

# GDAL 3.7 and newer asks programmers this in the log of every process, where users read it.
warnings.filterwarnings("ignore", message="Neither (gdal|ogr|osr).UseExceptions", category=FutureWarning)
