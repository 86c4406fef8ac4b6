"""Frames, pinhole cameras, the equivalent error, its refinement, and the tiles: all double precision, no files."""
