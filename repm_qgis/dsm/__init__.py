"""From height maps to a surface model: gridding, aggregation, outliers, orthophoto and point cloud."""
