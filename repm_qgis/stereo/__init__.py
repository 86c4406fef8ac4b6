"""Two views of a tile: epipolar rectification, heights from disparities, and height maps on disk."""
