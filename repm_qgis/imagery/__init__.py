"""Windowed reading and writing of rasters, brightness, and warping."""
