"""Tie points: where they are searched, keypoints and their matches, subpixel alignment, tracks."""
