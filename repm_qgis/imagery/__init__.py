"""Windowed reading and writing of rasters, the stretch of intensities, and warping."""
