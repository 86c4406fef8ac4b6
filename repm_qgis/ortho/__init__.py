"""From a finished surface model and its images to an orthophoto."""
