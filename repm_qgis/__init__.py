"""REPM engine: accurate surface models from satellite images with RPCs.

The method is that of Hong et al., "Refined Equivalent Pinhole Model for Large-scale 3D Reconstruction from
Spaceborne CCD Imagery". The engine knows nothing of QGIS; ``python -m repm_qgis STAGE JOB.json`` runs one stage.
"""

__version__ = "0.1.0"
