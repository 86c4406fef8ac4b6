"""From height maps to a surface model: gridding, aggregation, outliers, what does not fit the images, the rasters."""
