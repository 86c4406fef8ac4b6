"""A DSM as a page for the browser that turns it, drapes rasters over it, and draws profiles: offline, in one file."""
